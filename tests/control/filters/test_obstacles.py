import re
from pathlib import Path

import numpy as np
import pytest

from kinfeas.backends.analytic import AnalyticBackend
from kinfeas.control.drive import action_size, base_twist
from kinfeas.control.execution import ExecutionConfig, SubgoalMotion
from kinfeas.control.filters.feasibility import FeasibilityFilter
from kinfeas.control.filters.obstacle_distance import ObstacleFilter
from kinfeas.control.filters.rollout import RolloutPlanner
from kinfeas.control.kinematic_step import KinematicStep
from kinfeas.control.loop import Loop
from kinfeas.core import spatial
from kinfeas.core.backend import ObstacleDistances
from kinfeas.core.errors import KinfeasError
from kinfeas.core.start import Start
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolver
from kinfeas.plugins.linear import Linear
from kinfeas.robots.loading import load_robot
from kinfeas.robots.robot import joint_jumps
from kinfeas.sim2real.deploy.passing import Passing

KEPT, DT, RADIUS = 0.05, 0.1, 0.3


class Pillars(AnalyticBackend):
    """The analytic world with pillars, about which round bases drive."""

    def __init__(self, *pillars):
        super().__init__()
        self.pillars, self.asked = np.array(pillars).reshape(-1, 2), []

    def obstacle_distances(self, within):
        self.asked.append(within)
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


def start_of(robot, n, seed=0):
    rng = np.random.default_rng(seed)
    base = spatial.planar_pose(*rng.uniform(-1.0, 1.0, (3, n)) * [[0.1], [0.1], [3.0]])
    joints = np.tile(robot.home["home"], (n, 1))
    return base, joints


def loop_among(robot, backend, n, execution=None):
    base, joints = start_of(robot, n)
    loop = Loop(
        IkSolver(robot),
        [SubgoalMotion(Linear())],
        backend,
        DT,
        execution or ExecutionConfig(min_obstacle_distance=KEPT),
    )
    ee = spatial.compose(base, forward(loop.solver.chain, joints))
    goal = spatial.integrate(ee, np.tile([1.0, 0, 0, 0, 0, 0], (n, 1)), 1.0)
    rngs = [np.random.default_rng(i) for i in range(n)]
    loop.start(Start(base, joints, goal[:, np.newaxis]), rngs)
    return loop


def test_no_base_comes_nearer_than_it_should(robot):
    rng, n = np.random.default_rng(1), 32
    angle = rng.uniform(-np.pi, np.pi, 9)
    backend = Pillars(*(0.8 * np.stack([np.cos(angle), np.sin(angle)], axis=1)))
    loop = loop_among(robot, backend, n)
    wish, nearest = rng.uniform(-1.0, 1.0, (n, loop.action_size)), np.full(n, np.inf)
    for step in range(200):
        if step % 50 == 0:
            wish = np.sign(rng.uniform(-1.0, 1.0, wish.shape))
        loop.step(wish)
        nearest = np.minimum(nearest, backend.nearest)
    # A turn and a drive at once lead a little off the straight way.
    assert nearest.min() > KEPT - 0.005
    assert nearest.min() < KEPT + 0.02
    assert np.linalg.norm(loop.state.base_pose[:, :2], axis=1).max() > 0.3


def test_far_from_everything_commands_stay_as_they_are(robot):
    backend, plain = Pillars([9.0, 9.0]), AnalyticBackend()
    loops = [loop_among(robot, backend, 8), loop_among(robot, plain, 8, ExecutionConfig())]
    rng = np.random.default_rng(2)
    for _ in range(20):
        action = rng.uniform(-2.0, 2.0, (8, loops[0].action_size))
        for loop in loops:
            loop.step(action)
    np.testing.assert_array_equal(backend.state.base_pose, plain.state.base_pose)
    np.testing.assert_array_equal(loops[0].joint_command, loops[1].joint_command)


def test_a_base_slides_along_what_is_in_its_way():
    robot = load_robot("hsr")
    backend = Pillars(*([1.0, y] for y in np.linspace(-1.0, 3.0, 81)))
    loop = loop_among(robot, backend, 1)
    backend.state.base_pose[:] = spatial.planar_pose(np.array([0.6]), np.zeros(1), np.zeros(1))
    for _ in range(50):
        loop.step(np.array([[0.7, 0.7, 0.0]]))
    x, y = backend.state.base_pose[0, :2]
    assert x == pytest.approx(1.0 - RADIUS - KEPT, abs=0.01)
    assert y == pytest.approx(50 * DT * robot.base.max_velocity * 0.7, rel=0.2)


def test_a_base_may_leave_what_it_touches(robot):
    backend = Pillars([RADIUS, 0.0])
    loop = loop_among(robot, backend, 1)
    backend.state.base_pose[:] = spatial.IDENTITY
    back = np.zeros((1, loop.action_size))
    back[0, 0] = -1.0
    loop.step(back)
    assert backend.state.base_pose[0, 0] == pytest.approx(-robot.base.max_velocity * DT)


def test_it_looks_as_far_as_the_fastest_base_takes_to_brake(robot):
    backend, base = Pillars([9.0, 9.0]), robot.base
    loop_among(robot, backend, 1).step(np.zeros((1, action_size(base))))
    fastest = base.max_velocity + 0.5 * base.max_rotation
    brakes = min(base.max_acceleration, 0.5 * base.max_rotation_acceleration)
    far = max(fastest**2 / brakes, 2.0 * DT * fastest)
    assert backend.asked == [pytest.approx(KEPT + far)]


def test_a_base_turns_aside_before_it_leaves_its_way():
    """Its corner is in the way of a pillar: it turns the corner away, and drives on."""
    hsr = load_robot("hsr")
    corner = ObstacleDistances(
        np.array([[[0.3, 0.3]]]), np.array([[[1.0, 0.0]]]), np.array([[KEPT]])
    )
    limits = ObstacleFilter(hsr.base, Blind(lambda: corner), KEPT, DT).limits(1)
    held = limits.hold(np.array([[[0.5, 0.0, 0.0]]]))[0, 0]
    assert held[0] == pytest.approx(0.5, rel=0.05)
    way = held[0] * hsr.base.max_velocity - 0.3 * held[2] * hsr.base.max_rotation
    assert way == pytest.approx(0.0, abs=1e-5)


def test_where_it_cannot_turn_fast_enough_it_leaves_its_way():
    hsr = load_robot("hsr")
    corner = ObstacleDistances(
        np.array([[[0.3, 0.05]]]), np.array([[[1.0, 0.0]]]), np.array([[KEPT]])
    )
    limits = ObstacleFilter(hsr.base, Blind(lambda: corner), KEPT, DT).limits(1)
    held = limits.hold(np.array([[[1.0, 0.0, 0.0]]]))[0, 0]
    assert held[2] == pytest.approx(1.0)
    assert held[0] * hsr.base.max_velocity == pytest.approx(0.05 * hsr.base.max_rotation, rel=1e-3)


def test_a_base_that_yields_keeps_clear_as_well(solver):
    robot, rng, n = solver.robot, np.random.default_rng(0), 64
    lower, upper = robot.finite_joint_limits
    joints = rng.uniform(lower, upper, (n, len(robot.arm)))
    base = spatial.planar_pose(*np.zeros((3, n)))
    desired = spatial.compose(base, forward(solver.chain, joints))
    backend = Pillars([RADIUS + KEPT, 0.0], [0.0, RADIUS + KEPT])
    backend.reset(base, joints)
    limits = ObstacleFilter(robot.base, backend, KEPT, 0.5).limits(n)
    action = rng.uniform(-1.0, 1.0, (n, action_size(robot.base)))
    action = limits.hold(action[:, np.newaxis])[:, 0]
    kinematic_step = KinematicStep(solver, 0.5)
    as_given, _ = kinematic_step(action, base, desired, joints)
    twist, arm = FeasibilityFilter(kinematic_step)(action, base, desired, joints, None, limits)
    assert (twist != as_given).any(axis=1).sum() > 5
    in_time = arm.feasible & ~joint_jumps(robot, joints, arm.joint_positions, 0.5)
    assert in_time.any()
    # Bases stand as near as they may, and drive neither forwards nor to the left.
    forwards, left = twist[:, 0], twist[:, 1]
    if robot.base.drive == "omnidirectional":
        assert max(forwards.max(), left.max()) < 1e-4
    else:
        assert forwards.max() < 0.02  # it turns first


def test_no_row_depends_on_the_others(robot):
    backend, rng = Pillars([0.4, 0.0], [0.0, 0.45]), np.random.default_rng(3)
    base, joints = start_of(robot, 16)
    backend.reset(base, joints)
    limits = ObstacleFilter(robot.base, backend, KEPT, DT).limits(16)
    action = rng.uniform(-1.0, 1.0, (16, 2, action_size(robot.base)))
    together = limits.hold(action)
    assert (together != action).any()
    rows = np.array([3, 11])
    np.testing.assert_array_equal(limits.of(rows).hold(action[rows]), together[rows])


def test_held_commands_are_carried_out_as_they_are(robot):
    backend, rng = Pillars([0.4, 0.0], [0.0, 0.45]), np.random.default_rng(4)
    base, joints = start_of(robot, 64)
    backend.reset(base, joints)
    limits = ObstacleFilter(robot.base, backend, KEPT, DT).limits(64)
    held = limits.hold(rng.uniform(-2.0, 2.0, (64, 1, action_size(robot.base))))[:, 0]
    speed = np.linalg.norm(base_twist(robot.base, base, held, DT)[:, :2], axis=1)
    assert speed.max() <= robot.base.max_velocity * (1.0 + 1e-12)


def test_what_looks_ahead_sees_nothing_in_its_way():
    robot = load_robot("hsr")

    class Still:
        def act(self, policy_input):
            return np.zeros((1, 3))

    loop, policy = loop_among(robot, Pillars([9.0, 9.0]), 1), RolloutPlanner(Still())
    policy.watch(loop)
    assert policy.act(loop.policy_input).shape == (1, 3)


def test_a_backend_that_sees_nothing_is_refused():
    robot = load_robot("hsr")
    sentence = "min_obstacle_distance=0.05 needs a backend .* AnalyticBackend does not"
    for backend in (AnalyticBackend(), Passing(AnalyticBackend())):
        with pytest.raises(KinfeasError, match=sentence):
            loop_among(robot, backend, 1)


class Blind(Pillars):
    """Says nothing of the kind."""

    def __init__(self, answer):
        super().__init__([9.0, 9.0])
        self.answer = answer

    def obstacle_distances(self, within):
        return self.answer()


@pytest.mark.parametrize(
    ("answer", "sentence"),
    [
        (
            lambda: None,
            r"^backend Blind must return ObstacleDistances from obstacle_distances, not NoneType$",
        ),
        (lambda: 1 / 0, r"^backend Blind fails in obstacle_distances: ZeroDivisionError: "),
        (
            lambda: ObstacleDistances(np.zeros((2, 1, 2)), np.zeros((2, 1, 2)), np.zeros((2, 1))),
            r"^backend Blind must measure 1 robots, not 2$",
        ),
        (
            lambda: ObstacleDistances(np.zeros((1, 2)), np.zeros((1, 2)), np.zeros(1)),
            "fails in obstacle_distances: ValueError: closest_point, normal and distance must be ",
        ),
        (
            lambda: ObstacleDistances(
                np.full((1, 1, 2), np.nan), np.zeros((1, 1, 2)), np.zeros((1, 1))
            ),
            "fails in obstacle_distances: ValueError: closest_point and normal must be finite ",
        ),
        (
            lambda: ObstacleDistances(
                np.zeros((1, 1, 2)), np.zeros((1, 1, 2)), np.full((1, 1), np.nan)
            ),
            "fails in obstacle_distances: ValueError: distance must be a number",
        ),
    ],
)
def test_what_is_no_answer_is_said_in_one_sentence(answer, sentence):
    hsr = load_robot("hsr")
    for backend in (Blind(answer), Passing(Blind(answer))):
        min_obstacle_distance = ObstacleFilter(hsr.base, backend, KEPT, DT)
        with pytest.raises(KinfeasError, match=sentence):
            min_obstacle_distance.limits(1)


def test_the_scan_of_the_documentation_keeps_a_round_base_clear():
    page = (Path(__file__).parents[3] / "docs" / "deploy.md").read_text(encoding="utf-8")
    space: dict[str, object] = {}
    exec(re.findall(r"```python\n(.*?)```", page, re.DOTALL)[-1], space)
    hsr, angles = load_robot("hsr"), np.linspace(-1.5, 1.5, 181)
    wall = 0.5 / np.cos(angles[:, np.newaxis]) * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    obstacle_distances = space["near_to_disc"](wall, RADIUS, 1.0)
    assert obstacle_distances.distance.min() == pytest.approx(0.5 - RADIUS)
    limits = ObstacleFilter(hsr.base, Blind(lambda: obstacle_distances), 0.5 - RADIUS, DT).limits(1)
    held = limits.hold(np.array([[[0.5, 0.5, 0.0]]]))[0, 0]
    np.testing.assert_allclose(held, [0.0, 0.5, 0.0], atol=0.03)
