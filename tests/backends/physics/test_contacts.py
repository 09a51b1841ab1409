from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kinfeas.control.execution import SubgoalMotion
from kinfeas.control.filters.obstacle_distance import ObstacleFilter
from kinfeas.control.loop import Loop
from kinfeas.core import spatial
from kinfeas.core.start import Start
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolver
from kinfeas.plugins.linear import Linear
from kinfeas.robots.loading import load_robot
from kinfeas.robots.urdf_file import parse_urdf
from tests.backends.conftest import place, stay
from tests.builders import twist

WALL = -2.95  # m, x of the wall's front


def test_a_robot_alone_touches_nothing_and_has_no_obstacles(world, begin):
    begin()
    stay(world, 5)
    assert not world.contacts(0).base
    assert not world.contacts(0).arm
    near = world.obstacle_distances(0.3)
    assert near.distance.shape == (1, 0)
    assert near.closest_point.shape == near.normal.shape == (1, 0, 2)


def test_a_base_in_a_wall_touches_it(world, begin):
    begin(x=-2.3)
    stay(world, 150, twist(-0.2))
    assert world.touched() == ["wall"]
    assert len({body for _, body, _ in world.contacts(0).base}) == 1
    assert not world.contacts(0).arm


def test_an_arm_in_a_wall_touches_it(world, begin, between_fingers):
    begin(wall=np.array([*between_fingers[:2], 0.0, 0.0, 0.0, 0.0, 1.0]))
    stay(world, 2)
    assert world.touched() == ["wall"]
    assert world.contacts(0).arm
    assert world.obstacle_distances(0.02).distance.size == 0  # only the base counts


@pytest.mark.parametrize("yaw", [0.0, 0.7, 2.0, -2.6])
def test_distance_and_normal_of_a_wall(world, begin, yaw):
    begin(x=-2.3, yaw=yaw)
    near = world.obstacle_distances(1.0)
    assert near.distance.shape[1] > 1  # rays from corners, too
    heading = np.array([np.cos(yaw), np.sin(yaw)])
    to_world = np.array([heading, [-heading[1], heading[0]]])
    normals, points = near.normal[0] @ to_world, near.closest_point[0] @ to_world + [-2.3, 0.0]
    np.testing.assert_allclose(normals, np.tile([-1.0, 0.0], (len(normals), 1)), atol=1e-6)
    np.testing.assert_allclose(points[:, 0] - near.distance[0], WALL, atol=2e-3)


def test_all_parts_that_are_near_a_wall_are_measured(scene, opened):
    # In this pose, the rear of PR2's base and the shoulder of its other arm are as near.
    world = opened(load_robot("pr2"), scene)
    place(world, x=-2.3, yaw=1.42)
    near = world.obstacle_distances(1.0)
    ends = near.closest_point[near.distance < near.distance.min() + 0.02, 0]
    assert ends.max() - ends.min() > 0.5


def test_a_base_of_capsules_has_its_size(scene, opened, tmp_path):
    scout = Path(__file__).parents[3] / "examples" / "own_robot"
    text = (scout / "robot.urdf").read_text()
    path = tmp_path / "robot.urdf"
    path.write_text(text.replace('<cylinder radius="0.26"', '<capsule radius="0.26"'))
    assert path.read_text() != text
    robot = load_robot(scout)
    world = opened(replace(robot, urdf_path=path, urdf=parse_urdf(path)), scene)
    place(world, x=WALL + 0.26 + 0.05, yaw=np.pi / 2.0)
    assert world.obstacle_distances(0.055).distance.min() == pytest.approx(0.05, abs=4e-3)


def test_contacts_begin_where_the_distance_ends(world, begin):
    begin(x=-2.3)
    distance = world.obstacle_distances(1.0).distance.min()
    assert world.obstacle_distances(distance - 0.01).distance.size == 0
    assert world.obstacle_distances(distance + 0.01).distance.size > 0
    begin(x=-2.3 - distance + 3e-4)
    assert not world.touched()
    begin(x=-2.3 - distance - 2e-3)
    assert world.touched()
    assert world.obstacle_distances(1.0).distance.min() < 0.0


def test_the_grasped_link_and_objects_beneath_are_no_obstacles(hsr, scene, opened):
    world = opened(hsr, scene)
    world.handle("wall", "wall")
    place(world, x=-2.3)
    assert world.obstacle_distances(1.0).distance.size == 0
    place(world, x=-2.5)
    stay(world, 5)
    assert not (world.contacts(0).base or world.touched())
    sunk = scene.with_poses({"bar": np.array([0.0, 0.0, -0.2, 0.0, 0.0, 0.0, 1.0])})
    place(world, scene=sunk)
    assert world.obstacle_distances(0.3).distance.size == 0


@pytest.mark.parametrize("kept", [None, 0.03])
def test_the_obstacle_filter_stops_the_base_before_a_wall(world, begin, kept):
    state, solver = begin(x=-2.2, yaw=0.3), IkSolver(world.robot)
    filters = [] if kept is None else [ObstacleFilter(kept)]
    loop = Loop(solver, [SubgoalMotion(Linear())], world, 0.02, filters=filters)
    ee = spatial.compose(state.base_pose, forward(solver.chain, state.joint_positions))
    start = Start(state.base_pose, state.joint_positions, ee[:, np.newaxis])
    loop.start(start, [np.random.default_rng(0)])
    back, nearest = np.zeros((1, loop.command_size)), np.inf
    back[:, 0] = -1.0
    for _ in range(300):
        loop.step(back)
        nearest = min(nearest, world.obstacle_distances(1.0).distance.min())
    assert nearest < 0.015 if kept is None else nearest == pytest.approx(kept, abs=5e-3)
