"""Contacts, distances to obstacles and solids: those of the geometry, in both engines."""

import itertools

import numpy as np
import pytest

from kinfeas.backends.analytic import AnalyticBackend
from kinfeas.core.solids import Solids
from kinfeas.core.spatial import planar_pose
from kinfeas.kinematics.ik import IkSolver
from kinfeas.kinematics.solids import collides
from kinfeas.robots.loading import load_robot
from kinfeas.scenes.scene import read_scene
from tests.backends.conftest import STL, place, stay
from tests.builders import twist

WALL = -2.95  # m, x of the wall's front
DT, ROWS = 0.02, np.arange(2)


def test_a_wall_stops_the_base_which_touches_it(world, begin):
    begin(x=-2.3)
    before = stay(world, 150, twist(-0.2))[-1].base_pose
    assert world.touched() == ["wall"]
    assert len({body for _, body, _ in world.touching(0).base}) == 1
    assert not world.touching(0).arm
    after = stay(world, 25, twist(-0.2))[-1].base_pose
    assert np.linalg.norm(after[0, :2] - before[0, :2]) <= 0.005


@pytest.mark.parametrize("yaw", [0.7, -2.6])
def test_distance_and_normal_of_a_wall(world, begin, yaw):
    begin(x=-2.3, yaw=yaw)
    near = world.obstacle_distances(1.0)
    assert near.distance.shape[1] > 1  # rays from corners, too
    heading = np.array([np.cos(yaw), np.sin(yaw)])
    to_world = np.array([heading, [-heading[1], heading[0]]])
    normals, points = near.normal[0] @ to_world, near.closest_point[0] @ to_world + [-2.3, 0.0]
    np.testing.assert_allclose(normals, np.tile([-1.0, 0.0], (len(normals), 1)), atol=1e-6)
    np.testing.assert_allclose(points[:, 0] - near.distance[0], WALL, atol=2e-3)


def engine_distance(world):
    """Return the engine's own distance between the base and the objects of the scene."""
    if world.engine == "PyBullet":
        sim = world.sims[0]
        body, closest = sim.body, sim.physics.client.getClosestPoints
        points = [
            point
            for item in sim.furniture.bodies.values()
            for point in closest(body.body, item, 2.0)
        ]
        return min(point[8] for point in points if point[3] not in body.arm_links)
    from mujoco import mj_geomDistance

    from kinfeas.backends.mujoco.model import ROBOT

    model, data = world.model, world.sims.data(0)
    owner, on_arm = (each[model.engine.geom_bodyid] for each in (model.owner, model.on_arm))
    base, objects = np.flatnonzero((owner == ROBOT) & ~on_arm), np.flatnonzero(owner >= 0)
    pairs = itertools.product(base.tolist(), objects.tolist())
    return min(mj_geomDistance(model.engine, data, *pair, 2.0, None) for pair in pairs)


@pytest.mark.parametrize(("name", "wider"), [("hsr", 2e-3), ("pr2", 0.02)])
def test_distances_to_an_open_door_are_those_of_the_engine(name, wider, opened):
    """PR2's base has tilted shapes, which slices enclose."""
    world = opened(load_robot(name), read_scene("doorway").with_joints({"door": {"hinge": 1.0}}))
    for x, y, yaw in ((-0.5, 3.0, 0.0), (-0.6, 2.8, 1.2), (0.6, 3.2, -2.0), (1.0, 3.1, 2.5)):
        place(world, x, y, yaw)
        distance, exact = world.obstacle_distances(2.0).distance.min(), engine_distance(world)
        assert 0.0 < exact < 1.0
        assert exact - wider <= distance <= exact + 2e-3


def test_all_parts_that_are_near_a_wall_are_measured(scene, opened):
    # In this pose, the rear of PR2's base and the shoulder of its other arm are as near.
    world = opened(load_robot("pr2"), scene)
    place(world, x=-2.3, yaw=1.42)
    near = world.obstacle_distances(1.0)
    ends = near.closest_point[near.distance < near.distance.min() + 0.02, 0]
    assert ends.max() - ends.min() > 0.5


@pytest.mark.parametrize(
    ("shape", "reach"),
    [('capsule radius="0.26" length="0.28"', 0.26), ('mesh filename="p.stl" scale="6 6 6"', 0.6)],
)
def test_a_base_has_its_size(shape, reach, scene, opened, scout):
    robot = scout(lambda urdf: urdf.replace('cylinder radius="0.26" length="0.28"', shape))
    assert shape in robot.urdf_path.read_text()
    (robot.urdf_path.parent / "p.stl").write_bytes(STL)
    world = opened(robot, scene)
    place(world, x=WALL + reach + 0.05, yaw=np.pi)
    assert world.obstacle_distances(0.055).distance.min() == pytest.approx(0.05, abs=4e-3)


def test_contacts_begin_where_the_distance_ends(world, begin):
    begin(x=-2.3)
    distance = world.obstacle_distances(1.0).distance.min()
    assert world.obstacle_distances(distance - 0.01).distance.size == 0
    assert world.obstacle_distances(distance + 0.01).distance.size > 0
    begin(x=-2.3 - distance + 2e-3)
    assert not world.touched()
    begin(x=-2.3 - distance - 2e-3)
    assert world.touched()
    assert world.obstacle_distances(1.0).distance.min() < 0.0


def test_the_grasped_link_and_objects_beneath_are_no_obstacles(hsr, scene, opened):
    world = opened(hsr, scene)
    world.handle("wall", "wall")
    place(world, x=-2.3)
    assert world.obstacle_distances(1.0).distance.size == 0
    place(world, x=-2.75)
    assert world.touched() == ["wall"]  # only the arm may touch it
    assert not world.touching(0).arm
    sunk = scene.with_poses({"bar": np.array([0.0, 0.0, -0.2, 0.0, 0.0, 0.0, 1.0])})
    place(world, scene=sunk)
    assert world.obstacle_distances(0.3).distance.size == 0


@pytest.fixture
def rooms(hsr, opened):
    """A function that builds a world of two robots: a box beside one, a board before the other."""

    def build():
        world = opened(hsr)
        world.reset(*start(hsr))
        solids = Solids.empty(2, 3)
        solids.pose[:, 1] = [[0.0, 0.6, 0.0], [0.8, 0.1, 0.3]]
        solids.size[:, 1] = [[0.3, 0.3, 0.0, 0.5], [0.25, 0.25, 0.3, 1.5]]
        solids.cylinder[1, 1] = True
        solids.velocity[:, 1] = [[0.02, 0.03], [-0.1, 0.0]]
        solids.span[:, 1] = [0.03, 1.0]
        world.place_solids(solids, ROWS)
        return world

    return build


def start(robot):
    return planar_pose(*np.zeros((3, 2))), np.stack([robot.home["home"]] * 2)


def run(world, ticks, *command):
    _, joints = start(world.robot)
    command = np.repeat(twist(*command), 2, axis=0)
    return [world.step(command, joints, DT) for _ in range(ticks)]


def test_contacts_are_those_of_the_geometry(rooms, hsr):
    world, model, touches = rooms(), IkSolver(hsr).collision, []
    for _ in range(100):
        (state,) = run(world, 1, 0.0, 0.1)
        contacts = [world.touching(row) for row in ROWS]
        touched = [[len(contact.base) > 0, len(contact.arm) > 0] for contact in contacts]
        shapes = state.joint_positions, state.base_pose, world.solids.after()
        touches.append((touched, collides(model, *shapes)))
    by_engine, by_geometry = np.swapaxes(touches, 0, 1)
    assert by_geometry.any(axis=0).tolist() == [[True, False], [False, True]]
    assert by_engine.any(axis=0).tolist() == [[True, False], [False, True]]
    assert np.abs(np.argmax(by_engine, axis=0) - np.argmax(by_geometry, axis=0)).max() <= 2
    assert world.touched(0) == ["solid 1"]


def test_solids_move_and_are_measured_as_in_the_analytic_world(rooms, hsr):
    world, analytic = rooms(), AnalyticBackend(hsr)
    for command in ((), (), (0.0, 0.3)):  # there and back
        state = run(world, 20 if command else 90, *command)[-1]
        analytic.reset(state.base_pose, state.joint_positions)
        analytic.place_solids(world.solids.after(), ROWS)
        obstacles, near = (each.obstacle_distances(1.0) for each in (world, analytic))
        np.testing.assert_allclose(obstacles.distance, near.distance, atol=1e-9)
        np.testing.assert_allclose(obstacles.closing_speed, near.closing_speed, atol=1e-9)
    assert np.all(np.abs(near.closing_speed).max(axis=1) > 0.01)
    np.testing.assert_array_equal(world.scan().ranges, analytic.scan().ranges)
    assert world.scan().ranges.min() < 1.0


def test_a_reset_takes_solids_away_and_leaves_no_trace(rooms, hsr):
    world, fresh = rooms(), rooms()
    joints = [state.joint_velocities for state in run(world, 40, 0.0, 0.1)]
    world.reset(*(part[1:] for part in start(hsr)), ROWS[1:])
    assert world.touched(1) == []
    assert world.solids.after().filled.any(axis=1).tolist() == [True, False]
    world.place_solids(fresh.solids.start.of(ROWS[1:]), ROWS[1:])
    world.reset(*start(hsr))
    world.place_solids(fresh.solids.start, ROWS)
    np.testing.assert_array_equal([s.joint_velocities for s in run(world, 40, 0.0, 0.1)], joints)
