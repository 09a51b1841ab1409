import numpy as np
import pytest

from kinfeas.backends.pybullet.backend import PyBulletBackend
from kinfeas.backends.pybullet.nearby import Surroundings
from kinfeas.control.execution import ExecutionConfig, SubgoalMotion
from kinfeas.control.loop import Loop
from kinfeas.core import spatial
from kinfeas.core.backend import SupportsObstacleDistances
from kinfeas.core.start import Start
from kinfeas.kinematics.forward import forward
from kinfeas.plugins.linear import Linear
from kinfeas.robots.loading import load_robot
from tests.backends.pybullet.conftest import stay, twist

WALL = -2.95
"""Where the wall's front is when it stands where the scene has it, metres."""


def test_a_robot_alone_is_near_to_nothing(world, begin):
    begin()
    near = world.obstacle_distances(0.3)
    assert near.distance.shape == (1, 0)
    assert near.closest_point.shape == near.normal.shape == (1, 0, 2)


@pytest.mark.parametrize("yaw", [0.0, 0.7, 2.0, -2.6])
def test_a_wall_is_as_far_away_as_it_is_and_lies_where_it_does(world, begin, yaw):
    begin(x=-2.3, yaw=yaw)
    near = world.obstacle_distances(1.0)
    one = near.distance[0].argmin()
    heading = np.array([np.cos(yaw), np.sin(yaw)])
    to_world = np.array([heading, [-heading[1], heading[0]]])
    np.testing.assert_allclose(near.normal[0, one] @ to_world, [-1.0, 0.0], atol=1e-6)
    place = near.closest_point[0, one] @ to_world + [-2.3, 0.0]
    assert place[0] - near.distance[0, one] == pytest.approx(WALL, abs=2e-3)


def test_nothing_is_touched_before_the_distance_is_used_up(world, begin):
    begin(x=-2.3)
    distance = world.obstacle_distances(1.0).distance.min()
    begin(x=-2.3 - distance + 2e-3)
    assert world.sims[0].free()
    begin(x=-2.3 - distance - 2e-3)
    assert not world.sims[0].free()
    assert world.obstacle_distances(1.0).distance.min() < 0.0


def test_what_is_farther_away_is_not_seen(world, begin):
    begin(x=-2.3)
    away = world.obstacle_distances(1.0).distance.min()
    assert world.obstacle_distances(away - 0.01).distance.size == 0
    assert world.obstacle_distances(away + 0.01).distance.size > 0


def test_a_wall_that_only_the_arm_is_near_is_not_seen(world, begin, between_fingers):
    begin(wall=np.array([between_fingers[0] + 0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]))
    assert world.obstacle_distances(0.02).distance.size == 0


def test_what_is_handled_is_not_seen(world, begin):
    begin(x=-2.3)
    bodies, wall = (
        world.sims[0].furniture.bodies.values(),
        world.sims[0].furniture.link("wall", "wall"),
    )
    around = Surroundings(world.sims[0].body)
    assert around.obstacle_distances(bodies, 1.0).distance.size > 0
    assert around.obstacle_distances(bodies, 1.0, [wall]).distance.size == 0


def test_what_lies_beneath_is_not_in_the_way(world, begin):
    begin(bar=np.array([0.0, 0.0, -0.2, 0.0, 0.0, 0.0, 1.0]))
    bar = world.sims[0].furniture.bodies["bar"]
    assert world.sims[0].physics.client.getClosestPoints(world.sims[0].body.body, bar, 0.3)
    assert world.obstacle_distances(0.3).distance.size == 0


def test_a_floor_and_nothing_else():
    backend = PyBulletBackend(load_robot("hsr"))
    try:
        assert isinstance(backend, SupportsObstacleDistances)
        home = backend.sims[0].body.robot.home["home"]
        backend.reset(spatial.IDENTITY[np.newaxis], home[np.newaxis])
        assert backend.obstacle_distances(1.0).distance.shape == (1, 0)
    finally:
        backend.close()


def test_a_base_measured_while_it_drives_comes_nearer(world, begin):
    begin(x=-2.3)
    before = world.obstacle_distances(1.0).distance.min()
    states = stay(world, 50, twist(-0.1))
    moved = -2.3 - states[-1].base_pose[0, 0]
    assert moved > 0.05
    assert world.obstacle_distances(1.0).distance.min() == pytest.approx(before - moved, abs=2e-3)


@pytest.mark.parametrize("kept", [0.0, 0.03])
def test_a_base_that_keeps_clear_stops_before_the_wall(world, begin, solver, kept):
    begin(x=-2.2, yaw=0.3)
    robot = solver.robot
    loop = Loop(
        solver, [SubgoalMotion(Linear())], world, 0.02, ExecutionConfig(min_obstacle_distance=kept)
    )
    base, joints = world.sims[0].body.state().base_pose, robot.home["home"][np.newaxis]
    ee = spatial.compose(base, forward(solver.chain, joints))
    loop.start(Start(base, joints, ee[:, np.newaxis]), [np.random.default_rng(0)])
    back = np.zeros((1, loop.action_size))
    back[:, 0] = -1.0
    nearest = np.inf
    for _ in range(300):
        loop.step(back)
        nearest = min(nearest, world.obstacle_distances(1.0).distance.min())
    assert nearest < 0.015 if not kept else nearest == pytest.approx(kept, abs=5e-3)
