from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from kinfeas.backends.analytic import AnalyticBackend
from kinfeas.config import PluginSpec
from kinfeas.control.assemble import assemble
from kinfeas.control.execution import GRASP_METRES, ExecutionConfig, SubgoalMotion
from kinfeas.control.observation import HORIZON, ObservedState, observe
from kinfeas.core import spatial
from kinfeas.core.backend import RobotState
from kinfeas.core.errors import KinfeasError, raised_by
from kinfeas.core.start import Start
from kinfeas.kinematics.drive import base_twist
from kinfeas.kinematics.forward import forward
from kinfeas.plugins.linear import Linear
from tests.builders import random_poses, rngs


class Robots(AnalyticBackend):
    """Records commands, grips and seeds; `disturb` may change the state after each step."""

    def __init__(self, disturb=lambda robots: None):
        super().__init__()
        self.gripper, self.disturb = self, disturb
        self.steps, self.grips = [], []

    def grip(self, grip, env_ids):
        self.grips.append((grip, env_ids.tolist(), len(self.steps)))

    def step(self, base_twist, joint_targets, dt):
        self.steps.append((base_twist.copy(), joint_targets.copy()))
        super().step(base_twist, joint_targets, dt)
        self.disturb(self)
        return self.state

    def shift(self, base=0.0, joints=0.0):
        """Move the robots; return their state."""
        state = self.state
        self.state = RobotState(state.base_pose + base, state.joint_positions + joints)
        return self.state


def along_x(metres):
    return np.array([metres, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])


def starts(robot, n, seed=0):
    """Return n episodes from the home configuration to goals one or two metres away."""
    rng = np.random.default_rng(seed)
    heading, bearing = rng.uniform(-np.pi, np.pi, (2, n))
    goal, reach = random_poses(n, seed), rng.uniform(1.0, 2.0, n)
    goal[:, 0], goal[:, 1], goal[:, 2] = reach * np.cos(bearing), reach * np.sin(bearing), 0.7
    base = spatial.planar_pose(np.zeros(n), np.zeros(n), heading)
    return Start(base, np.tile(robot.home["home"], (n, 1)), goal[:, np.newaxis])


def make_loop(solver, n, backend=None, **options):
    loop = assemble(solver, [SubgoalMotion(Linear())], backend or AnalyticBackend(), **options)
    loop.start(starts(solver.robot, n), rngs(n))
    return loop


def chained(solver, n, subgoals, heights, backend=None, **execution):
    """Return a loop with sub-goals so near to the EE, in z, that they end at once."""
    start, linear = starts(solver.robot, n), Linear()
    poses = np.repeat(make_loop(solver, n).desired[:, np.newaxis], len(heights), axis=1)
    poses[:, :, 2] += heights
    motions = [SubgoalMotion(linear, **subgoal) for subgoal in subgoals]
    execution = ExecutionConfig(**execution)
    loop = assemble(solver, motions, backend or AnalyticBackend(), execution=execution)
    loop.start(replace(start, target_poses=poses), rngs(n))
    return loop


def rest(loop, steps=1):
    """Step with resting bases; return the last outcome."""
    for _ in range(steps):
        outcome = loop.step(np.zeros((len(loop.desired), loop.command_size)))
    return outcome


def test_desired_pose_is_the_generators_integrated_whatever_the_base_does(solver):
    loop, generator, rng = make_loop(solver, 4), Linear(), np.random.default_rng(0)
    desired = loop.desired.copy()
    target, dt = starts(solver.robot, 4).target_poses[:, 0], np.full(4, HORIZON)
    state = generator.start(desired, target, rngs(4))
    for _ in range(30):
        twist, state = generator.twist(state, desired, target, dt)
        desired = spatial.integrate(desired, twist, HORIZON)
        np.testing.assert_array_equal(loop.observation.planned, desired)
        loop.step(rng.uniform(-1.0, 1.0, (4, loop.command_size)))
        np.testing.assert_array_equal(loop.desired, desired)


def test_arm_is_placed_relative_to_the_base_that_was_commanded(solver):
    rng, robots = np.random.default_rng(0), Robots()
    loop, feasible = make_loop(solver, 6, robots), 0
    for _ in range(20):
        before, action = robots.state.base_pose, rng.uniform(-0.3, 0.3, (6, loop.command_size))
        outcome = loop.step(action)
        twist, targets = robots.steps[-1]
        np.testing.assert_array_equal(twist, base_twist(loop.robot.base, before, action, loop.dt))
        commanded = spatial.integrate(before, twist, loop.dt)
        ee = spatial.compose(commanded, forward(solver.chain, targets))
        errors = np.stack(spatial.distance(ee, loop.desired))
        reported = np.stack([outcome.position_error, outcome.rotation_error])
        solved = outcome.feasible
        np.testing.assert_allclose(errors[:, solved], reported[:, solved], atol=1e-7)
        feasible += solved.sum()
    assert feasible > 60


def test_observations_are_of_the_measured_state(solver):
    robots = Robots(lambda robots: robots.shift(along_x(0.01)))
    loop = make_loop(solver, 3, robots)
    outcome = rest(loop)
    base, joints = robots.state.base_pose, robots.state.joint_positions
    in_base = forward(solver.chain, joints)
    ee = spatial.compose(base, in_base)
    np.testing.assert_array_equal(loop.ee_pose, ee)
    off = np.linalg.norm(ee[:, :3] - loop.desired[:, :3], axis=1)
    np.testing.assert_allclose(outcome.deviation, off, atol=1e-12)
    seen = ObservedState(base, in_base, loop.observation.planned, loop.sequence.goal, joints)
    np.testing.assert_array_equal(loop.observation.values, observe(seen))


def test_an_infeasible_step_keeps_the_arm_still(solver):
    robots = Robots()
    loop = make_loop(solver, 3, robots)
    rest(loop)
    far = np.array([[0.0], [6.0], [0.0]]) * along_x(1.0)  # beyond reach of its desired pose
    loop.measure(robots.shift(far))
    joints, planned = robots.state.joint_positions, loop.observation.planned
    outcome = rest(loop)
    np.testing.assert_array_equal(robots.state.joint_positions[1], joints[1])
    np.testing.assert_array_equal(loop.desired, planned)
    assert not (outcome.feasible[1] or outcome.joint_jump[1])
    assert outcome.deviation[1] > 5.0
    loop.measure(robots.shift(-far))  # later steps may recover
    assert rest(loop, 2).feasible[1]


@pytest.mark.parametrize(("options", "steps", "planned"), [
    ({"dt": 0.02}, 5, 1.0), ({"dt": 0.05}, 2, 1.0),
    ({"execution": ExecutionConfig(time_scale=0.5)}, 2, 0.5),
])  # fmt: skip
def test_control_rate_and_time_scale_do_not_change_path_and_observation(
    solver, options, steps, planned
):
    loop, plain = loops = make_loop(solver, 4, **options), make_loop(solver, 4)
    np.testing.assert_array_equal(loop.observation.values, plain.observation.values)
    for _ in range(5):
        # Policies that do not learn read the motion as it will be.
        metres, full = (spatial.distance(x.observation.planned, x.desired)[0] for x in loops)
        np.testing.assert_allclose(metres, planned * full, rtol=0.03)
        rest(loop, steps)
        rest(plain)
        # The motion is a dynamic system of its own time: close, whatever the rate.
        np.testing.assert_allclose(loop.desired, plain.desired, atol=2e-3)


def test_backends_get_a_seed_for_each_episode(solver):
    robots, seeds = AnalyticBackend(), {}
    robots.seed = lambda drawn, rows: seeds.update(zip(rows.tolist(), drawn.tolist(), strict=True))
    loop = make_loop(solver, 4, robots)
    first = dict(seeds)
    assert len(set(first.values())) == 4
    loop.start(starts(solver.robot, 1), [rngs(4)[2]], np.array([1]))
    assert seeds == {**first, 1: first[2]}


@pytest.mark.parametrize("prepares", [False, True])
def test_subgoals_end_within_25_mm_and_the_last_one_finishes(solver, prepares):
    # Preparing a step while the robot moves changes nothing.
    robots = Robots(lambda robots: loop.prepare() if prepares else None)
    loop = chained(solver, 2, ({}, {"dwell": 0.12}, {}), (-0.01, -0.02, -0.02), robots)
    outcomes = [rest(loop) for _ in range(5)]
    assert [outcome.subgoal[0] for outcome in outcomes] == [0, 1, 1, 1, 2]
    assert [outcome.finished[0] for outcome in outcomes] == [False] * 4 + [True]
    assert max(outcome.goal_distance.max() for outcome in outcomes) <= 0.025


@pytest.mark.parametrize(
    ("metres", "degrees", "finished"),
    [(0.024, 0.0, True), (0.026, 0.0, False), (0.0, 11.9, True), (0.0, 12.1, False)],
)
def test_success_is_within_25_mm_and_12_degrees(solver, metres, degrees, finished):
    def displace(robots):
        twist = np.array([[metres, 0, 0, 0, 0, np.deg2rad(degrees)]])
        in_base = forward(solver.chain, robots.state.joint_positions)
        shift = spatial.relative(np.array([spatial.IDENTITY]), in_base)
        base = spatial.compose(spatial.integrate(loop.desired, twist, 1.0), shift)
        robots.state = replace(robots.state, base_pose=base)

    loop = chained(solver, 1, ({},), (0.0,), Robots(displace))
    outcome = rest(loop)
    assert outcome.feasible.all()
    np.testing.assert_allclose(outcome.goal_distance, metres, atol=1e-3)
    assert outcome.finished == [finished]


def test_only_a_feasible_step_ends_a_subgoal(solver):
    loop = chained(solver, 1, ({},), (0.0,))
    away = loop.robots.base_pose + along_x(5.0)
    loop.measure(RobotState(away, loop.robots.joint_positions))
    outcome = rest(loop)
    assert not outcome.feasible.any()
    assert np.all(outcome.goal_distance <= 0.025)
    assert not outcome.finished.any()


def test_grippers_act_at_the_ends_of_subgoals(solver):
    robots, subgoals = Robots(), ({"dwell": 0.2, "grip": "close"}, {"grip": "open"})
    rest(chained(solver, 2, subgoals, (-0.01, -0.01), robots), 4)
    assert robots.grips[:2] == [("close", [0, 1], 1), ("open", [0, 1], 4)]


def test_a_gripper_acts_when_the_ee_has_come_near_enough(solver):
    robots, subgoals = Robots(), ({"grip": "close"}, {})
    loop = chained(solver, 1, subgoals, (-0.02, 0.0), robots, grasp_settle_time=20.0)
    away = [rest(loop).goal_distance[0] for _ in range(199) if not robots.grips]
    assert away[-1] <= GRASP_METRES < away[-2]


def test_ik_starts_from_the_last_joint_command(solver):
    loop, expected = (make_loop(solver, 2, Robots()) for _ in range(2))
    for _ in range(5):
        rest(loop)
        rest(expected)
        loop.measure(RobotState(loop.robots.base_pose, loop.robots.joint_positions - 0.05))
    np.testing.assert_array_equal(loop.backend.steps[-1][1], expected.backend.steps[-1][1])


@pytest.mark.parametrize("name", ["base_pose", "joint_positions", "planned"])
def test_a_policy_cannot_write_into_its_observation(solver, name):
    def act(observation):
        getattr(observation, name)[:, 0] = 0.0

    loop = make_loop(solver, 2, policy=SimpleNamespace(act=act, observation_terms=()))
    assert loop.observation.values.shape == (2, 0)
    with pytest.raises(ValueError, match="read-only"):
        loop.step()


def test_base_and_motion_pause_while_an_arm_reconfigures(solver):
    first_arm = np.zeros((2, len(solver.robot.arm)))
    first_arm[0, 1] = 1.0
    loop, resumed = (
        make_loop(solver, 2, Robots(), execution=ExecutionConfig(arm_settle_timeout=0.5))
        for _ in range(2)
    )
    loop.measure(loop.backend.shift(joints=first_arm))
    moves = []
    for period in range(10):
        if period == 3:
            resumed.restore(loop.snapshot())
            loop = resumed
        there = period == 7
        off = (1.0 - there) * first_arm
        loop.backend.disturb = lambda robots, off=off: robots.shift(joints=off)
        before = loop.desired
        outcome = loop.step(np.ones((2, loop.command_size)))
        moves.append(np.any(loop.desired != before, axis=1).tolist())
        assert np.any(loop.backend.steps[-1][0] != 0.0, axis=1).tolist() == moves[-1]
        assert outcome.time_scale.tolist() == moves[-1]
    paused, free = [False, True], [True, True]
    # For half a second, and later again, since it was there in between.
    assert moves == [paused] * 5 + [free] * 4 + [paused]


def resting(terms):
    """Return a policy whose bases rest."""
    return SimpleNamespace(
        observation_terms=terms, act=lambda given: np.zeros((len(given.base_pose), 3))
    )


class Filter:
    """A filter that changes commands by a function, and notes which rows it was reset for."""

    def __init__(self, change):
        self.change, self.fresh = change, []

    def reset(self, rows, n):
        self.fresh.append(rows.tolist())

    def __call__(self, period):
        return replace(period, command=self.change(period.command))


def halved(command):
    return 0.5 * command


def test_policies_and_filters_are_reset_for_rows_that_begin_anew(solver):
    policy, halves, resets = resting(("joint_positions",)), Filter(halved), []
    policy.reset = lambda rows, n: resets.append(rows.tolist())
    loop = make_loop(solver, 3, filters=[halves], policy=policy)
    np.testing.assert_array_equal(loop.observation.values, loop.robots.joint_positions)
    for _ in range(2):
        loop.step()
    loop.start(starts(solver.robot, 1), rngs(1), np.array([1]))
    assert loop.sequence.periods.tolist() == [2, 0, 2]
    assert resets == halves.fresh == [[0, 1, 2], [1]]


def test_filters_apply_in_order(solver):
    rates = []
    for changes in ((np.ones_like, halved), (halved, np.ones_like)):
        robots = Robots()
        rest(make_loop(solver, 2, robots, filters=map(Filter, changes)))
        rates.append(robots.steps[-1][0][:, 5])
    np.testing.assert_allclose(2.0 * rates[0], rates[1])
    assert np.all(rates[1] == solver.robot.base.max_rotation)
    # A move that an earlier filter has computed is that of another command.
    loop = make_loop(solver, 2, filters=[PluginSpec("feasibility"), Filter(halved)])
    before = loop.robots.base_pose
    loop.step(np.ones((2, 3)))
    twist = base_twist(loop.robot.base, before, loop.previous_command, loop.dt)
    moved = spatial.integrate(before, twist, loop.dt)
    np.testing.assert_array_equal(loop.robots.base_pose, moved)


def test_a_motion_that_slows_down_gets_arms_of_its_own(solver):
    def half_speed(period):
        return period.slowed(np.full(len(period.command), 0.5))

    arms = []
    for filters in ([half_speed], [PluginSpec("feasibility"), half_speed]):
        loop = make_loop(solver, 8, filters=filters)
        assert rest(loop).feasible.all()
        arms.append(loop.robots.joint_positions)
    np.testing.assert_array_equal(*arms)


def writing(period):
    period.base_pose[:, 0] += 0.01
    return period


@pytest.mark.parametrize("scale", [np.nan, -1.0, 2.0])
def test_motions_slow_down_by_fractions(solver, scale):
    filters = [lambda period: period.slowed(np.full(2, scale))]
    with pytest.raises(KinfeasError, match="slowed") as caught:
        rest(make_loop(solver, 2, filters=filters))
    assert raised_by(caught.value) == "command filter function"


@pytest.mark.parametrize(("command_filter", "word"), [
    (Filter(lambda command: command[:, :1]), "Filter.*shape"),
    (Filter(lambda command: np.full_like(command, np.nan)), "Filter: the command is not finite"),
    (Filter(lambda command: None), "Filter.*NoneType"),
    (lambda period: period.command, "function.*Period.*ndarray"),
    (lambda period: period.changed(time_scale=np.full(2, np.nan)), "function: the time_scale"),
    (lambda period: period.changed(time_scale=np.full(2, -0.5)), "function: the time_scale"),
    (writing, "function.*write.*'base_pose'"),
])  # fmt: skip
def test_wrong_results_of_a_filter_are_errors(solver, command_filter, word):
    with pytest.raises(KinfeasError, match=f"command filter {word}"):
        rest(make_loop(solver, 2, filters=[command_filter]))


@pytest.mark.parametrize("terms", [("goal_positon",), "goal_position", 5, [["ee_position"]]])
def test_terms_of_policies_are_known(solver, terms):
    with pytest.raises(KinfeasError, match="policy SimpleNamespace: 'observation_terms'"):
        make_loop(solver, 1).set_policy(resting(terms))
