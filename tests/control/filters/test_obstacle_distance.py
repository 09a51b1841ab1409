from dataclasses import replace

import numpy as np
import pytest

from kinfeas.backends.analytic import AnalyticBackend
from kinfeas.config import PluginSpec
from kinfeas.control.assemble import assemble
from kinfeas.control.drive import base_twist, command_size
from kinfeas.control.execution import SubgoalMotion
from kinfeas.control.filters.obstacle_distance import ObstacleFilter, VelocityDamper
from kinfeas.core import spatial
from kinfeas.core.backend import ObstacleDistances
from kinfeas.core.errors import KinfeasError
from kinfeas.core.start import Start
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolver
from kinfeas.plugins.linear import Linear
from kinfeas.robots.loading import load_robot

KEPT, DT, RADIUS = 0.05, 0.1, 0.3
KEEP = PluginSpec("obstacle_distance", {"min_distance": KEPT})
ROBOTS = pytest.mark.parametrize("robot", ["hsr", "tiago"], indirect=True)


@pytest.fixture
def robot(request):
    return load_robot(getattr(request, "param", "hsr"))


class Pillars(AnalyticBackend):
    def __init__(self, *pillars):
        super().__init__()
        self.obstacles = self
        self.pillars = np.array(pillars).reshape(-1, 2)

    def obstacle_distances(self, within):
        base = self.state.base_pose
        heading = spatial.yaw(base)[:, np.newaxis]
        x, y = np.moveaxis(self.pillars - base[:, np.newaxis, :2], 2, 0)
        cosine, sine = np.cos(heading), np.sin(heading)
        way = np.stack([cosine * x + sine * y, cosine * y - sine * x], axis=2)
        away = np.linalg.norm(way, axis=2)
        normal = way / away[..., np.newaxis]
        distance = np.where(away - RADIUS < within, away - RADIUS, np.inf)
        return ObstacleDistances(RADIUS * normal, normal, distance)

    @property
    def nearest(self):
        way = self.pillars - self.state.base_pose[:, np.newaxis, :2]
        return np.linalg.norm(way, axis=2).min(axis=1) - RADIUS


class Fixed(AnalyticBackend):
    def __init__(self, answer):
        super().__init__()
        self.obstacles = self
        self.obstacle_distances = lambda within: answer()


def start_of(robot, n):
    rng = np.random.default_rng(0)
    base = spatial.planar_pose(*rng.uniform(-1.0, 1.0, (3, n)) * [[0.1], [0.1], [3.0]])
    return base, np.tile(robot.home["home"], (n, 1))


def loop_among(robot, backend, n, filters=()):
    base, joints = start_of(robot, n)
    filters = [KEEP, *filters]
    loop = assemble(IkSolver(robot), [SubgoalMotion(Linear())], backend, dt=DT, filters=filters)
    ee = spatial.compose(base, forward(loop.solver.chain, joints))
    goal = spatial.integrate(ee, np.tile([1.0, 0, 0, 0, 0, 0], (n, 1)), 1.0)
    rngs = [np.random.default_rng(i) for i in range(n)]
    loop.start(Start(base, joints, goal[:, np.newaxis]), rngs)
    return loop


def constraints(robot, backend, n=1):
    return VelocityDamper(robot.base, DT, KEPT).constraints(backend, n)


@ROBOTS
def test_no_base_comes_nearer_than_its_distance(robot):
    rng, n = np.random.default_rng(1), 32
    angle = rng.uniform(-np.pi, np.pi, 9)
    backend = Pillars(*(0.8 * np.stack([np.cos(angle), np.sin(angle)], axis=1)))
    loop = loop_among(robot, backend, n)
    wish, nearest = rng.uniform(-1.0, 1.0, (n, loop.command_size)), np.full(n, np.inf)
    for step in range(200):
        if step % 50 == 0:
            wish = np.sign(rng.uniform(-1.0, 1.0, wish.shape))
        loop.step(wish)
        nearest = np.minimum(nearest, backend.nearest)
    # A turn and a drive at once lead a little off the straight way.
    assert KEPT - 0.005 < nearest.min() < KEPT + 0.02
    assert np.linalg.norm(loop.robots.base_pose[:, :2], axis=1).max() > 0.3


def test_a_base_may_leave_an_obstacle_that_it_touches(robot):
    backend = Pillars([RADIUS, 0.0])
    loop = loop_among(robot, backend, 1)
    backend.state.base_pose[:] = spatial.IDENTITY
    loop.step(np.array([[-1.0, 0.0, 0.0]]))
    assert backend.state.base_pose[0, 0] == pytest.approx(-robot.base.max_velocity * DT)


@pytest.mark.parametrize(("dt", "rotation"), [(1e-3, 9.0), (1e-3, 0.5), (1.0, 9.0)])
def test_half_of_the_braking_and_half_of_the_way_suffice(robot, dt, rotation):
    way, ahead = 0.02, np.array([[[1.0, 0.0]]])
    near = Fixed(lambda: ObstacleDistances(0.3 * ahead, ahead, np.array([[KEPT + way]])))
    robot = replace(robot, base=replace(robot.base, max_rotation_acceleration=rotation))
    velocity = VelocityDamper(robot.base, dt, KEPT).constraints(near, 1).limit[0, 0]
    base = robot.base
    braking = min(base.max_acceleration, 0.5 * base.max_rotation_acceleration)
    expected = way / (2.0 * dt) if dt == 1.0 else np.sqrt(2.0 * 0.5 * braking * way)
    assert velocity == pytest.approx(expected)


def test_a_base_gives_way_to_what_comes_nearer(robot):
    ahead = np.array([[[1.0, 0.0], [0.0, 1.0]]])
    coming = Fixed(
        lambda: ObstacleDistances(0.3 * ahead, ahead, np.full((1, 2), KEPT), np.array([[0.1, -9]]))
    )
    held = constraints(robot, coming).hold(np.array([[[0.5, 0.5, 0.0]]]))[0, 0]
    np.testing.assert_allclose(held * robot.base.max_velocity, [-0.1, 0.0, 0.0], atol=1e-5)


def test_a_distance_that_is_too_small_is_restored(robot):
    ahead, near = np.array([[[1.0, 0.0]]]), np.array([[KEPT - 0.01]])
    answer = ObstacleDistances(0.3 * ahead, ahead, near)
    held = constraints(robot, Fixed(lambda: answer)).hold(np.ones((1, 1, 3)))[0, 0]
    assert held[0] * robot.base.max_velocity == pytest.approx(-0.02, abs=1e-5)


def test_a_base_that_cannot_turn_fast_enough_slows_down(robot):
    point, ahead = np.array([[[0.3, 0.05]]]), np.array([[[1.0, 0.0]]])
    corner = Fixed(lambda: ObstacleDistances(point, ahead, np.array([[KEPT]])))
    held = constraints(robot, corner).hold(np.array([[[1.0, 0.0, 0.0]]]))[0, 0]
    assert held[2] == pytest.approx(1.0)
    limit = 0.05 * robot.base.max_rotation
    assert held[0] * robot.base.max_velocity == pytest.approx(limit, rel=1e-3)


def test_candidates_of_the_feasibility_filter_keep_the_distance(robot):
    backend = Pillars(*([RADIUS + KEPT, y] for y in np.linspace(-1.0, 1.0, 21)))
    loop, rng = (
        loop_among(robot, backend, 64, [PluginSpec("feasibility")]),
        np.random.default_rng(0),
    )
    backend.state.base_pose[:] = spatial.IDENTITY
    before = loop.robots.base_pose[:, 0].copy()
    loop.step(rng.uniform(-1.0, 1.0, (64, 3)))
    assert (loop.robots.base_pose[:, 0] - before).max() < 1e-4


@ROBOTS
def test_held_commands_are_within_the_base_limits_and_do_not_depend_on_other_rows(robot):
    backend, rng = Pillars([0.4, 0.0], [0.0, 0.45]), np.random.default_rng(4)
    base, joints = start_of(robot, 64)
    backend.reset(base, joints)
    limits = constraints(robot, backend, 64)
    action = rng.uniform(-2.0, 2.0, (64, 1, command_size(robot.base)))
    held = limits.hold(action)
    speed = np.linalg.norm(base_twist(robot.base, base, held[:, 0], DT)[:, :2], axis=1)
    assert speed.max() <= robot.base.max_velocity * (1.0 + 1e-12)
    rows = np.array([3, 11])
    np.testing.assert_array_equal(limits.of(rows).hold(action[rows]), held[rows])


@pytest.mark.parametrize("answer", [
    lambda: None,
    lambda: 1 / 0,
    lambda: ObstacleDistances(*np.zeros((2, 2, 1, 2)), np.zeros((2, 1))),  # two robots
    lambda: ObstacleDistances(*np.zeros((2, 1, 2)), np.zeros(1)),
    lambda: ObstacleDistances(*np.full((2, 1, 1, 2), np.nan), np.zeros((1, 1))),
    lambda: ObstacleDistances(*np.zeros((2, 1, 1, 2)), np.full((1, 1), np.nan)),
    lambda: ObstacleDistances(*np.zeros((2, 1, 1, 2)), np.ones((1, 1)), np.full((1, 1), np.nan)),
])  # fmt: skip
def test_wrong_answers_of_a_backend_raise_errors_that_name_it(robot, answer):
    solver = IkSolver(robot)
    with pytest.raises(KinfeasError, match="AnalyticBackend"):
        ObstacleFilter(solver, AnalyticBackend(), DT)
    loop = loop_among(robot, Fixed(answer), 1)
    with pytest.raises((KinfeasError, ZeroDivisionError, ValueError)) as caught:
        loop.step(np.zeros((1, 3)))
    told = [str(caught.value), *getattr(caught.value, "__notes__", [])]
    assert any("Fixed" in text for text in told)
