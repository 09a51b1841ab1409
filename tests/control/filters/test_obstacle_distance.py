from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import nnls

from kinfeas.backends.analytic import AnalyticBackend
from kinfeas.config import PluginSpec
from kinfeas.control.assemble import assemble
from kinfeas.control.execution import SubgoalMotion
from kinfeas.control.filters.half_spaces import project
from kinfeas.control.filters.obstacle_distance import ObstacleFilter, VelocityDamper
from kinfeas.core import spatial
from kinfeas.core.backend import ObstacleDistances
from kinfeas.core.errors import KinfeasError
from kinfeas.core.start import Start
from kinfeas.kinematics.drive import base_twist, command_size
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolver
from kinfeas.plugins.linear import Linear
from kinfeas.robots.loading import load_robot
from tests.builders import rngs

MARGIN, DT, RADIUS = 0.05, 0.1, 0.3
AHEAD = np.array([[[1.0, 0.0]]])
ROBOTS = pytest.mark.parametrize("robot", ["hsr", "tiago"], indirect=True)


@pytest.fixture
def robot(request):
    return load_robot(getattr(request, "param", "hsr"))


class Pillars(AnalyticBackend):
    """Measures the distances of round bases to points."""

    def __init__(self, *pillars):
        super().__init__()
        self.obstacles, self.pillars = self, np.array(pillars).reshape(-1, 2)

    def obstacle_distances(self, within):
        offsets = self.pillars - self.state.base_pose[:, np.newaxis, :2]
        yaw = spatial.yaw(self.state.base_pose)
        to_base = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
        offsets = np.einsum("nkx,xyn->nky", offsets, to_base)
        length = np.linalg.norm(offsets, axis=2)
        normal = offsets / length[..., np.newaxis]
        distance = np.where(length - RADIUS < within, length - RADIUS, np.inf)
        return ObstacleDistances(RADIUS * normal, normal, distance)


class Fixed(AnalyticBackend):
    """Measures always the same."""

    def __init__(self, measure):
        super().__init__()
        self.obstacles, self.obstacle_distances = self, lambda within: measure()


def start_of(robot, n):
    rng = np.random.default_rng(0)
    base = spatial.planar_pose(*rng.uniform(-1.0, 1.0, (3, n)) * [[0.1], [0.1], [3.0]])
    return base, np.tile(robot.home["home"], (n, 1))


def loop_among(robot, backend, n, *filters):
    solver, (base, joints) = IkSolver(robot), start_of(robot, n)
    filters = [PluginSpec("obstacle_distance", {"min_distance": MARGIN}), *filters]
    loop = assemble(solver, [SubgoalMotion(Linear())], backend, dt=DT, filters=filters)
    goal = spatial.compose(base, forward(solver.chain, joints))
    goal[:, 0] += 1.0
    loop.start(Start(base, joints, goal[:, np.newaxis]), rngs(n))
    return loop


def constraints(robot, backend, n=1, dt=DT):
    return VelocityDamper(robot.base, dt, MARGIN).constraints(backend, n)


@ROBOTS
def test_no_base_comes_nearer_than_its_distance(robot):
    rng, n = np.random.default_rng(1), 32
    angle = rng.uniform(-np.pi, np.pi, 9)
    backend = Pillars(*(0.8 * np.stack([np.cos(angle), np.sin(angle)], axis=1)))
    loop, nearest = loop_among(robot, backend, n), np.inf
    for step in range(200):
        if step % 50 == 0:
            command = np.sign(rng.uniform(-1.0, 1.0, (n, loop.command_size)))
        loop.step(command)
        nearest = min(nearest, backend.obstacle_distances(9.0).distance.min())
    # A rotation and a drive at once lead a little off the straight line.
    assert MARGIN - 0.005 < nearest < MARGIN + 0.02
    assert np.linalg.norm(loop.robots.base_pose[:, :2], axis=1).max() > 0.3


def test_a_base_may_leave_an_obstacle_that_it_touches(robot):
    backend = Pillars([RADIUS, 0.0])
    loop = loop_among(robot, backend, 1)
    backend.state.base_pose[:] = spatial.IDENTITY
    loop.step(np.array([[-1.0, 0.0, 0.0]]))
    assert backend.state.base_pose[0, 0] == pytest.approx(-robot.base.max_velocity * DT)


@pytest.mark.parametrize(("dt", "rotation"), [(1e-3, 9.0), (1e-3, 0.5), (1.0, 9.0)])
def test_half_of_the_braking_and_half_of_the_distance_suffice(robot, dt, rotation):
    distance = 0.02
    near = Fixed(lambda: ObstacleDistances(0.3 * AHEAD, AHEAD, np.array([[MARGIN + distance]])))
    base = replace(robot.base, max_rotation_acceleration=rotation)
    velocity = constraints(replace(robot, base=base), near, dt=dt).limit[0, 0]
    braking = min(base.max_acceleration, 0.5 * rotation)
    expected = distance / (2.0 * dt) if dt == 1.0 else np.sqrt(2.0 * 0.5 * braking * distance)
    assert velocity == pytest.approx(expected)


TWO, LEFT = np.array([[[1.0, 0.0], [0.0, 1.0]]]), np.array([[[0.3, 0.05]]])


@pytest.mark.parametrize(("near", "command", "held"), [
    # The base evades an obstacle that moves towards it, and restores a distance.
    ((0.3 * TWO, TWO, np.full((1, 2), MARGIN), np.array([[0.1, -9.0]])),
     [0.5, 0.5, 0.0], [-0.1, 0.0, 0.0]),
    ((0.3 * AHEAD, AHEAD, np.array([[MARGIN - 0.01]])), [1.0, 0.0, 0.0], [-0.02, 0.0, 0.0]),
    # It slows down if it cannot turn fast enough, at 1.5 rad/s.
    ((LEFT, AHEAD, np.array([[MARGIN]])), [1.0, 0.0, 0.0], [0.075, 0.0, 1.5]),
    ((LEFT * [1.0, -1.0], AHEAD, np.array([[MARGIN]])), [1.0, 0.0, 0.0], [0.075, 0.0, -1.5]),
])  # fmt: skip
def test_held_velocities(robot, near, command, held):
    limits = constraints(robot, Fixed(lambda: ObstacleDistances(*near)))
    action = limits.hold(np.array([[command]]))[0, 0]
    full = [robot.base.max_velocity, robot.base.max_velocity, robot.base.max_rotation]
    np.testing.assert_allclose(action * full, held, atol=1e-4)


def test_candidates_of_the_feasibility_filter_keep_the_distance(robot):
    backend = Pillars(*([RADIUS + MARGIN, y] for y in np.linspace(-1.0, 1.0, 21)))
    loop = loop_among(robot, backend, 64, PluginSpec("feasibility"))
    backend.state.base_pose[:] = spatial.IDENTITY
    before = loop.robots.base_pose[:, 0].copy()
    loop.step(np.random.default_rng(0).uniform(-1.0, 1.0, (64, 3)))
    assert (loop.robots.base_pose[:, 0] - before).max() < 1e-4


@ROBOTS
def test_held_commands_are_within_the_base_limits_and_do_not_depend_on_other_rows(robot):
    backend, (base, joints) = Pillars([0.4, 0.0], [0.0, 0.45]), start_of(robot, 64)
    backend.reset(base, joints)
    limits = constraints(robot, backend, 64)
    size = 64, 1, command_size(robot.base)
    action = np.random.default_rng(4).uniform(-2.0, 2.0, size)
    held = limits.hold(action)
    speed = np.linalg.norm(base_twist(robot.base, base, held[:, 0], DT)[:, :2], axis=1)
    assert speed.max() <= robot.base.max_velocity * (1.0 + 1e-12)
    rows = np.array([3, 11])
    np.testing.assert_array_equal(limits.of(rows).hold(action[rows]), held[rows])


@pytest.mark.parametrize("measure", [
    lambda: None,
    lambda: 1 / 0,
    lambda: ObstacleDistances(*np.zeros((2, 2, 1, 2)), np.zeros((2, 1))),  # two robots
    lambda: ObstacleDistances(*np.zeros((2, 1, 2)), np.zeros(1)),
    lambda: ObstacleDistances(*np.full((2, 1, 1, 2), np.nan), np.zeros((1, 1))),
    lambda: ObstacleDistances(*np.zeros((2, 1, 1, 2)), np.full((1, 1), np.nan)),
    lambda: ObstacleDistances(*np.zeros((2, 1, 1, 2)), np.ones((1, 1)), np.full((1, 1), np.nan)),
])  # fmt: skip
def test_errors_of_measurements_name_the_backend(robot, measure):
    with pytest.raises(KinfeasError, match="AnalyticBackend"):
        ObstacleFilter(IkSolver(robot), AnalyticBackend(), DT)
    loop = loop_among(robot, Fixed(measure), 1)
    with pytest.raises((KinfeasError, ZeroDivisionError, ValueError)) as caught:
        loop.step(np.zeros((1, 3)))
    texts = [str(caught.value), *getattr(caught.value, "__notes__", [])]
    assert any("Fixed" in text for text in texts)


SLACK = 1e-6


def nearest(point, normals, offsets):
    """Return the point of the half-spaces that is nearest.

    Least distance programming (Lawson and Hanson, "Solving Least Squares Problems", chapter 23).
    """
    over = normals @ point - offsets
    tall = np.vstack([-normals.T, over])
    target = np.zeros(len(tall))
    target[-1] = 1.0
    residual = tall @ nnls(tall, target)[0] - target
    return point - residual[:-1] / residual[-1]


@settings(max_examples=40)
@given(seed=st.integers(0, 10_000), count=st.integers(1, 24), size=st.integers(2, 3))
def test_points_outside_come_to_the_nearest_point_and_others_stay(seed, count, size):
    rng = np.random.default_rng(seed)
    normals = rng.normal(scale=0.2, size=(count, size))
    normals[:, -1] *= rng.choice([1.0, 20.0])  # rotations: borders are nearly parallel
    offsets = np.maximum(rng.uniform(-0.1, 0.2, count), 0.0)  # some borders have the origin
    for point in rng.uniform(-1.0, 1.0, (10, size)):
        moved = point.copy()
        outside = project(moved, normals, offsets, SLACK)
        assert outside == ((normals @ point - offsets).max() > SLACK)
        assert (normals @ moved - offsets).max() <= 2.0 * SLACK
        expected = nearest(point, normals, offsets) if outside else point
        np.testing.assert_allclose(moved, expected, atol=1e-5 if outside else 0.0)


@pytest.mark.parametrize(("point", "normals", "offsets", "expected"), [
    ([0.5, 0.3], [[1.0, 0.0], [0.0, 1.0]], [-0.2, 0.4], [-0.2, 0.3]),  # the origin is outside
    ([-0.5, 0.2], [[1.0, 0.0], [0.0, 1.0]], [-0.2, 0.4], [-0.5, 0.2]),
    # Without a common point they are widened.
    ([0.5, 0.7], [[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0]], [-0.2, -0.1, 0.3], [0.0, 0.3]),
])  # fmt: skip
def test_half_spaces_without_the_origin(point, normals, offsets, expected):
    moved = np.array(point)
    outside = project(moved, np.array(normals), np.array(offsets), SLACK)
    assert outside == (point != expected)
    np.testing.assert_allclose(moved, expected, atol=1e-5)
