from dataclasses import fields, replace

import numpy as np
import pytest

from kinfeas.backends.analytic import AnalyticBackend
from kinfeas.config import PluginSpec
from kinfeas.control.assemble import assemble, read_sim2real, with_adapters
from kinfeas.control.execution import ExecutionConfig, SubgoalMotion
from kinfeas.control.response import BaseResponse, Predictor
from kinfeas.core.backend import LOCALISATION_SPEED
from kinfeas.core.metrics import lateness
from kinfeas.core.response import ResponseModel
from kinfeas.core.spatial import compose, distance, planar_pose
from kinfeas.core.start import Start
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolver
from kinfeas.plugins.linear import Linear
from kinfeas.policies.loading import load_policy
from kinfeas.robots.loading import load_robot
from kinfeas.robots.robot import joint_displacement
from tests.builders import assert_near, at, random_poses, rngs

LAG = PluginSpec("actuator_lag", {"base": 0.15, "arm": 0.03})
LIMITS = PluginSpec("acceleration_limit", {"linear": 1.0, "angular": 2.0})
JERKS = PluginSpec(LIMITS.name, {**LIMITS.parameters, "linear_jerk": 9, "angular_jerk": 20})
WHOLE = (
    PluginSpec("command_latency", {"seconds": 0.2}),
    PluginSpec("sensor_latency", {"seconds": 0.1}),
)
FRACTIONS = (
    PluginSpec("command_latency", {"seconds": 0.05}),
    PluginSpec("sensor_latency", {"seconds": 0.03}),
)
PART = 0.01
"""Period of robots with latencies of a fraction of a control period, seconds."""


@pytest.fixture(scope="module")
def solver():
    """IK of PR2, which has continuous joints."""
    return IkSolver(load_robot("pr2"))


class Drive:
    """Robots within adapters that follow random commands, and the predictions of their states.

    The robots advance in parts of a control period; `change` changes measurements.
    """

    def __init__(
        self, solver, adapters, dt, parts=1, rows=(0, 1, 2), change=lambda state: state, **response
    ):
        self.robot, self.dt, self.parts, n = solver.robot, dt, parts, len(rows)
        self.change = change
        self.backend = with_adapters(AnalyticBackend(), adapters, self.robot)
        self.predictor = Predictor(replace(self.backend.response, **response), solver, dt)
        self.rngs = [np.random.default_rng(row) for row in rows]
        self.targets = np.where(self.robot.continuous, 3.1, self.robot.home["home"])
        self.targets = np.tile(self.targets, (n, 1))
        x, y = np.array([rng.uniform(-2.0, 2.0, 2) for rng in self.rngs]).T
        self.backend.seed(np.array(rows, dtype=np.uint64), np.arange(n))
        state = self.backend.reset(planar_pose(x, y, np.full(n, np.pi)), self.targets)
        self.predicted, self.truth = (
            [self.predictor.start(change(state))],
            [state.true_state or state],
        )

    def step(self, steps=1):
        """Command random steps; return the last prediction."""
        fastest = self.robot.max_joint_velocity * self.dt
        for _ in range(steps):
            drawn = np.array([rng.uniform(-0.5, 0.5, 3 + len(fastest)) for rng in self.rngs])
            twist = np.zeros((len(drawn), 6))
            twist[:, [0, 1, 5]] = drawn[:, :3]
            self.targets = self.targets + drawn[:, 3:] * fastest
            for _ in range(self.parts):
                state = self.backend.step(twist, self.targets, self.dt / self.parts)
                self.truth.append(state.true_state or state)
            self.predictor.command(twist, self.targets, np.zeros((len(drawn), 7)))
            self.predicted.append(self.predictor.predict(self.change(state)))
        return self.predicted[-1]

    @property
    def errors(self):
        """Largest errors of predicted bases, metres and radians, and of joints."""
        delay, errors = round(self.predictor.delay / self.dt * self.parts), []
        arrived = self.truth[delay :: self.parts]
        for predicted, true in zip(self.predicted, arrived, strict=False):
            apart = distance(predicted.base_pose, true.base_pose)
            before, after = true.joint_positions, predicted.joint_positions
            joints = joint_displacement(self.robot, before, after)
            errors.append([np.max(apart[0]), np.max(apart[1]), np.abs(joints).max()])
        return np.max(errors, axis=0)


@pytest.mark.parametrize("dt", [0.02, 0.1])
@pytest.mark.parametrize("adapters", [
    [LAG], [LIMITS], [JERKS], WHOLE, [LAG, *WHOLE], [LAG, JERKS, *WHOLE], FRACTIONS,
    [LAG, *FRACTIONS],
])  # fmt: skip
def test_states_are_those_at_which_the_next_command_takes_effect(solver, adapters, dt):
    whole = FRACTIONS[0] not in adapters
    aged = adapters != [LAG, *WHOLE]  # else the latencies are those of the model
    drive = Drive(
        solver, adapters, dt, 1 if whole else round(dt / PART),
        change=lambda state: state if aged else replace(state, age=None),
    )  # fmt: skip
    drive.step(60)
    assert drive.errors.max() < 1e-9
    assert lateness(drive.predictor.sums) == pytest.approx(0.0, abs=1e-9)


def test_measured_ages_count_before_the_latency_of_the_model(solver):
    drive = Drive(solver, [LAG, *WHOLE], 0.02, sensor_latency=0.02)
    drive.step(60)
    assert drive.errors.max() < 1e-9


def test_arms_reach_far_targets_at_their_velocity_limits(solver):
    clamp = PluginSpec("velocity_clamp", {"linear": 9.0, "angular": 9.0})
    drive = Drive(solver, [clamp, *WHOLE], 0.02)
    drive.step(20)
    drive.targets = drive.targets + 0.5
    drive.step(40)
    assert drive.errors.max() < 1e-9


def test_measured_deviations_of_the_hand_from_the_kinematics_stay(solver):
    off = random_poses(1, reach=0.01)

    def beside(state):
        return replace(state, ee_in_base=compose(forward(solver.chain, state.joint_positions), off))

    predicted = Drive(solver, [LAG, *WHOLE], 0.02, change=beside).step(20)
    expected = compose(forward(solver.chain, predicted.joint_positions), off)
    assert_near(predicted.ee_in_base, expected, 1e-9, 1e-7)


@pytest.mark.parametrize("dt", [0.02, 0.1])
def test_arms_that_lead_are_on_time(solver, dt):
    response, speed = ResponseModel(arm_lag=0.05), 0.1 * solver.robot.max_joint_velocity
    backend = with_adapters(
        AnalyticBackend(), [PluginSpec("actuator_lag", {"base": 0.0, "arm": 0.05})], solver.robot
    )
    joints, rest = solver.robot.home["home"][np.newaxis], np.zeros((1, 6))
    backend.reset(at(), joints)
    lead = BaseResponse(response).lead(dt)
    for k in range(1, round(1.0 / dt) + 1):
        state = backend.step(rest, joints + speed * (k * dt + lead), dt)
    away = joint_displacement(solver.robot, joints + speed, state.joint_positions)
    np.testing.assert_allclose(away, 0.0, atol=1e-6)
    assert BaseResponse(ResponseModel(arm_lag=1e-5)).lead(dt) == pytest.approx(0.0)


# The limit of a period is not that of its parts. With limits of jerk at 10 Hz, errors are taken
# for jumps of the localisation.
@pytest.mark.parametrize(("dt", "limits"), [(0.02, JERKS), (0.02, LIMITS), (0.1, LIMITS)])
def test_limited_accelerations_in_fractions_of_a_period_are_nearly_predicted(solver, dt, limits):
    drive = Drive(solver, [LAG, limits, *FRACTIONS], dt, round(dt / PART), rows=range(12))
    drive.step(60)
    assert drive.errors.max() < 0.005


def test_jumps_of_the_localisation_are_followed_slowly_and_small_errors_at_once(solver):
    predictor, dt = Predictor(ResponseModel(base_lag=0.1), solver, 0.02), 0.02
    rest, joints = np.zeros((1, 6)), solver.robot.home["home"][np.newaxis]
    state = AnalyticBackend().reset(at(), joints)
    predictor.start(state)

    def seen(seconds, pose):
        for _ in range(round(seconds / dt)):
            predictor.command(rest, joints, pose)
            predicted = predictor.predict(replace(state, base_pose=pose))
        return np.array(distance(predicted.base_pose, at()))[:, 0]

    assert seen(0.1, at(0.003, 0.0, 0.003)) == pytest.approx(0.003, rel=0.02)
    assert seen(0.1, at()) == pytest.approx(0.0, abs=1e-4)
    followed = seen(1.0, at(0.06, 0.08, 0.1))
    assert followed == pytest.approx(LOCALISATION_SPEED, rel=0.02)
    assert seen(1.5, at(0.06, 0.08, 0.1)) == pytest.approx(0.1, rel=0.01)


def loop_of(solver, adapters=(), n=3, **execution):
    """Return PR2s at 50 Hz that are about to move their EEs by two metres."""
    policy, angle = load_policy("pretrained", solver.robot), np.linspace(-1.0, 1.0, n)
    loop = assemble(
        solver, [SubgoalMotion(Linear())], AnalyticBackend(), dt=0.02, adapters=adapters,
        filters=[PluginSpec("time_scaling")], policy=policy, execution=ExecutionConfig(**execution),
    )  # fmt: skip
    goal = np.zeros((n, 1, 7))
    goal[:, 0] = np.stack([2.0 * np.cos(angle), 2.0 * np.sin(angle), *np.zeros((5, n))], axis=1)
    goal[..., 2], goal[..., 6] = 0.8, 1.0
    home = np.tile(solver.robot.home["home"], (n, 1))
    loop.start(Start(planar_pose(*np.zeros((3, n))), home, goal), rngs(n))
    return loop


def run(loop, steps=200):
    """Step; return a function of the distances from what was desired periods ago, (steps, n)."""
    ee, desired = np.empty((2, steps, len(loop.desired), 3))
    for step in range(steps):
        loop.step()
        ee[step], desired[step] = loop.true_state[1][:, :3], loop.desired[:, :3]
    return lambda late=0: np.linalg.norm(ee[late:] - desired[: steps - late], axis=2)


def test_robots_without_delay_are_not_predicted(solver):
    at_once = PluginSpec("actuator_lag", {"base": 0.0, "arm": 0.0})
    plain, within = loop_of(solver), loop_of(solver, [at_once])
    for _ in range(30):
        outcome, other = plain.step(), within.step()
        for field in fields(outcome):
            expected, value = getattr(outcome, field.name), getattr(other, field.name)
            np.testing.assert_array_equal(value, expected)
    assert plain.response_sums is within.response_sums is None
    assert "predictor.motion" not in within.snapshot()


def test_a_line_is_followed_behind_delays_that_are_known(solver):
    noise = "base_noise", "joint_noise", "localisation", "head_start"
    late = [each for each in read_sim2real("pr2_like").adapters if each.name not in noise]
    predicted, at_once = loop_of(solver, late), loop_of(solver, late, response=ResponseModel())
    periods = round(predicted.backend.response.command_latency / predicted.dt)
    # Outcomes would compare them with different positions: a known latency is no deviation.
    predicted, at_once = run(predicted), run(at_once)
    assert predicted(periods).max() < 0.001
    assert at_once(periods).max() > 0.015
    assert predicted().mean() < 0.7 * at_once().mean()


def test_the_deviation_is_from_the_position_that_is_due(solver):
    loop = loop_of(solver, [LAG, *WHOLE])
    desired = [loop.desired[:, :3]] * 10
    for _ in range(30):
        desired.append(loop.desired[:, :3])
        outcome = loop.step()
        away = loop.true_state[1][:, :3] - desired[-10]
        np.testing.assert_allclose(outcome.deviation, np.linalg.norm(away, axis=1), atol=1e-12)


# It is a lower bound: the prediction adapts to bases that are late.
@pytest.mark.parametrize(("name", "delay"), [("base_lag", 0.2), ("command_latency", 0.1)])
def test_lateness_shows_a_model_of_half_the_delay(solver, name, delay):
    response = replace(ResponseModel(base_lag=0.1, command_latency=0.1), **{name: delay})
    late = [
        PluginSpec("actuator_lag", {"base": response.base_lag, "arm": 0.0}),
        PluginSpec("command_latency", {"seconds": response.command_latency}),
    ]
    right = loop_of(solver, late)
    wrong = loop_of(solver, late, response=replace(response, **{name: 0.5 * delay}))
    for loop in (right, wrong):
        run(loop)
    assert lateness(right.response_sums) == pytest.approx(0.0, abs=1e-6)
    assert 0.3 * delay < lateness(wrong.response_sums) < 0.5 * delay


def test_a_newer_measurement_of_resting_robots_begins_anew(solver):
    loop = loop_of(solver, [LAG, *WHOLE])
    run(loop, 20)
    start = np.tile(at(), (3, 1))
    loop.measure(loop.backend.reset(start, loop.robots.joint_positions))
    np.testing.assert_array_equal(loop.robots.base_pose, start)
