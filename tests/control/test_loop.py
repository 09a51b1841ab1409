from dataclasses import replace

import numpy as np
import pytest

from kinfeas.backends.analytic import AnalyticBackend
from kinfeas.config import PluginSpec
from kinfeas.control.assemble import assemble
from kinfeas.control.drive import base_twist
from kinfeas.control.execution import GRASP_METRES, ExecutionConfig, SubgoalMotion
from kinfeas.control.observation import HORIZON, Seen, observe
from kinfeas.core import spatial
from kinfeas.core.backend import Backend, RobotState
from kinfeas.core.errors import KinfeasError, raised_by
from kinfeas.core.start import Start
from kinfeas.kinematics.forward import forward
from kinfeas.plugins.linear import Linear
from tests.builders import random_poses, rngs


class Recorder(Backend):
    """A backend that records commands; tests may displace its robots by `disturb` in each step."""

    def __init__(self, disturb=lambda: None) -> None:
        self.steps: list[tuple] = []
        self.disturb = disturb

    def reset(self, base_pose, joint_positions, env_ids=None):
        if env_ids is None:
            self.base, self.joints = base_pose.copy(), joint_positions.copy()
        else:
            self.base[env_ids], self.joints[env_ids] = base_pose, joint_positions
        return self.state

    def step(self, base_twist, joint_targets, dt):
        self.steps.append((base_twist.copy(), joint_targets.copy(), dt))
        self.base = spatial.integrate(self.base, base_twist, dt)
        self.joints = joint_targets.copy()
        self.disturb()
        return self.state

    def close(self):
        pass

    @property
    def state(self):
        return RobotState(self.base.copy(), self.joints.copy())


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


def actions(loop, n, rng):
    return rng.uniform(-1.0, 1.0, (n, loop.command_size))


def still(loop):
    return np.zeros((len(loop.desired), loop.command_size))


def test_desired_pose_is_the_generators_integrated_whatever_the_base_does(solver):
    loop, generator, rng = make_loop(solver, 4), Linear(), np.random.default_rng(0)
    desired = loop.desired.copy()
    target, dt = starts(solver.robot, 4).target_poses[:, 0], np.full(4, HORIZON)
    state = generator.start(desired, target, rngs(4))
    for _ in range(30):
        twist, state = generator.twist(state, desired, target, dt)
        desired = spatial.integrate(desired, twist, HORIZON)
        np.testing.assert_array_equal(loop.observation.planned, desired)
        loop.step(actions(loop, 4, rng))
        np.testing.assert_array_equal(loop.desired, desired)


def test_arm_is_placed_relative_to_the_base_that_was_commanded(solver):
    rng, recorder = np.random.default_rng(0), Recorder()
    loop = make_loop(solver, 6, recorder)
    feasible = 0
    for _ in range(20):
        before, action = recorder.state.base_pose, 0.3 * actions(loop, 6, rng)
        step = loop.step(action)
        twist, targets, dt = recorder.steps[-1]
        expected = base_twist(loop.robot.base, before, action, dt)
        np.testing.assert_array_equal(twist, expected)
        commanded = spatial.integrate(before, twist, dt)
        ee = spatial.compose(commanded, forward(solver.chain, targets))
        found = np.stack(spatial.distance(ee, loop.desired))[:, step.feasible]
        reported = np.stack([step.position_error, step.rotation_error])[:, step.feasible]
        np.testing.assert_allclose(found, reported, atol=1e-7)
        feasible += step.feasible.sum()
    assert feasible > 60


def test_observations_are_of_the_measured_state(solver):
    recorder = Recorder()

    def slip():
        recorder.base[:, 0] += 0.01

    recorder.disturb = slip
    loop = make_loop(solver, 3, recorder)
    step = loop.step(still(loop))
    ee = spatial.compose(recorder.base, forward(solver.chain, recorder.joints))
    np.testing.assert_array_equal(loop.ee_pose, ee)
    np.testing.assert_allclose(
        step.deviation, np.linalg.norm(ee[:, :3] - loop.desired[:, :3], axis=1), atol=1e-12
    )
    in_base = forward(solver.chain, recorder.joints)
    expected = observe(
        Seen(recorder.base, in_base, loop.observation.planned, loop.sequence.goal, recorder.joints)
    )
    np.testing.assert_array_equal(loop.observation.values, expected)


def test_an_infeasible_step_keeps_the_arm_still(solver):
    recorder = Recorder()
    loop = make_loop(solver, 3, recorder)
    loop.step(still(loop))
    recorder.base[1, :2] += 6.0  # far beyond reach of its desired pose
    loop.start(starts(solver.robot, 1), rngs(1), np.array([0]))  # measures all rows
    joints, planned = recorder.joints.copy(), loop.observation.planned.copy()
    step = loop.step(still(loop))
    np.testing.assert_array_equal(recorder.joints[1], joints[1])
    np.testing.assert_array_equal(loop.desired, planned)
    assert not (step.feasible[1] or step.joint_jump[1])
    assert step.deviation[1] > 5.0
    # Later steps may recover.
    recorder.base[1, :2] -= 6.0
    loop.step(still(loop))
    assert loop.step(still(loop)).feasible[1]


@pytest.mark.parametrize("dt", [0.02, 0.05])
def test_control_rate_changes_the_step_but_not_the_horizon(solver, dt):
    fine, coarse = make_loop(solver, 4, dt=dt), make_loop(solver, 4)
    np.testing.assert_array_equal(fine.observation.values, coarse.observation.values)
    for _ in range(round(HORIZON / dt)):
        fine.step(still(fine))
    coarse.step(still(coarse))
    # The motion is a dynamic system of its own time: close, whatever the rate.
    np.testing.assert_allclose(fine.desired, coarse.desired, atol=1e-3)
    metres = np.linalg.norm(fine.observation.planned[:, :3] - fine.desired[:, :3], axis=1)
    coarse_metres = np.linalg.norm(
        coarse.observation.planned[:, :3] - coarse.desired[:, :3], axis=1
    )
    np.testing.assert_allclose(metres, coarse_metres, rtol=0.02)


class Drawing(AnalyticBackend):
    """Remembers the seeds that it is given, by row."""

    def seed(self, seeds, env_ids):
        self.seeds = dict(zip(env_ids.tolist(), seeds.tolist(), strict=True))


def test_backends_that_draw_get_a_seed_for_each_episode(solver):
    backend = Drawing()
    loop = make_loop(solver, 4, backend)
    first = backend.seeds
    assert len(set(first.values())) == len(first) == 4
    loop.start(starts(solver.robot, 1), [rngs(4)[2]], np.array([1]))
    assert backend.seeds == {1: first[2]}


def targets_at(loop, *shifts):
    """Return targets so near to the EE that sub-goals end at once, shape (n, sub-goals, 7)."""
    poses = np.repeat(loop.desired[:, np.newaxis], len(shifts), axis=1)
    poses[:, :, 2] += shifts
    return poses


def chained(solver, n, subgoals, shifts, backend=None, **execution):
    start = starts(solver.robot, n)
    start = replace(start, target_poses=targets_at(make_loop(solver, n), *shifts))
    linear = Linear()
    motions = [SubgoalMotion(linear, **subgoal) for subgoal in subgoals]
    execution = ExecutionConfig(**execution)
    loop = assemble(solver, motions, backend or Recorder(), execution=execution)
    loop.start(start, rngs(n))
    return loop


def test_subgoals_end_within_25_mm_and_the_last_one_finishes(solver):
    loop = chained(solver, 2, ({}, {"dwell": 0.2}, {}), (-0.01, -0.02, -0.02))
    seen = [loop.step(still(loop)) for _ in range(5)]
    assert [int(step.subgoal[0]) for step in seen] == [0, 1, 1, 1, 2]
    assert [bool(step.finished[0]) for step in seen] == [False] * 4 + [True]
    assert max(step.goal_distance.max() for step in seen) <= 0.025


def test_preparing_a_step_while_the_robot_moves_changes_nothing(solver):
    seen = []
    for prepares in (False, True):
        recorder = Recorder(lambda: loop.prepare() if prepares else None)  # noqa: B023
        loop = chained(solver, 2, ({}, {"dwell": 0.2}, {}), (-0.01, -0.02, -0.02), recorder)
        seen.append([(loop.step(still(loop)).subgoal, loop.observation.values) for _ in range(5)])
    for one, other in zip(*seen, strict=True):
        np.testing.assert_array_equal(one[0], other[0])
        np.testing.assert_array_equal(one[1], other[1])


@pytest.mark.parametrize(
    ("metres", "degrees", "finished"),
    [(0.024, 0.0, True), (0.026, 0.0, False), (0.0, 11.9, True), (0.0, 12.1, False)],
)
def test_success_is_within_25_mm_and_12_degrees(solver, metres, degrees, finished):
    recorder = Recorder()
    loop = chained(solver, 1, ({},), (0.0,), recorder)

    def displace():
        twist = np.array([[metres, 0, 0, 0, 0, np.deg2rad(degrees)]])
        in_base = forward(solver.chain, recorder.joints)
        shift = spatial.relative(np.array([spatial.IDENTITY]), in_base)
        recorder.base = spatial.compose(spatial.integrate(loop.desired, twist, 1.0), shift)

    recorder.disturb = displace
    step = loop.step(still(loop))
    assert step.feasible.all()
    np.testing.assert_allclose(step.goal_distance, metres, atol=1e-3)
    assert step.finished == [finished]


def test_only_a_feasible_step_ends_a_subgoal(solver):
    recorder = Recorder()
    loop = chained(solver, 1, ({},), (0.0,), recorder)
    away = np.array([5.0, 0, 0, 0, 0, 0, 0])
    loop.robots = RobotState(loop.robots.base_pose + away, loop.robots.joint_positions)
    step = loop.step(still(loop))
    assert not step.feasible.any()
    assert np.all(step.goal_distance <= 0.025)
    assert not step.finished.any()


class Hands(Recorder):
    """Writes down what the grippers are told, with the number of steps until then."""

    def __init__(self) -> None:
        super().__init__()
        self.gripper = self
        self.grips: list[tuple] = []

    def grip(self, grip, env_ids):
        self.grips.append((grip, env_ids.tolist(), len(self.steps)))


def test_grippers_act_at_the_ends_of_subgoals(solver):
    hands, subgoals = Hands(), ({"dwell": 0.2, "grip": "close"}, {"grip": "open"})
    loop = chained(solver, 2, subgoals, (-0.01, -0.01), hands)
    for _ in range(4):
        loop.step(still(loop))
    assert hands.grips[:2] == [("close", [0, 1], 1), ("open", [0, 1], 4)]


def test_a_gripper_acts_when_the_ee_has_come_near_enough(solver):
    hands = Hands()
    loop = chained(solver, 1, ({"grip": "close"}, {}), (-0.02, 0.0), hands, grasp_settle_time=20.0)
    away = [loop.step(still(loop)).goal_distance[0] for _ in range(199) if not hands.grips]
    assert away[-1] <= GRASP_METRES < away[-2]


def test_time_scale_changes_the_motion_but_not_the_observation(solver):
    plain, slow = loops = [
        make_loop(solver, 3, execution=ExecutionConfig(time_scale=scale)) for scale in (1.0, 0.5)
    ]
    np.testing.assert_array_equal(slow.observation.values, plain.observation.values)
    # Policies that do not learn read the motion as it will be.
    metres, radians = spatial.distance(slow.desired, slow.observation.planned)
    full_metres, full_radians = spatial.distance(plain.desired, plain.observation.planned)
    np.testing.assert_allclose(2.0 * metres, full_metres)
    np.testing.assert_allclose(2.0 * radians, full_radians)
    start = plain.desired
    for loop, steps in ((plain, 5), (slow, 10)):
        for _ in range(steps):
            loop.step(still(loop))
    ways = [spatial.distance(start, loop.desired)[0] for loop in loops]
    np.testing.assert_allclose(ways[1], ways[0], rtol=0.02)


def test_ik_starts_from_the_last_joint_command(solver):
    loop, expected = (make_loop(solver, 2, Recorder()) for _ in range(2))
    for _ in range(5):
        loop.step(still(loop))
        expected.step(still(expected))
        loop.robots = RobotState(loop.robots.base_pose, loop.robots.joint_positions - 0.05)
    joint_command, same = (one.backend.steps[-1][1] for one in (loop, expected))
    np.testing.assert_array_equal(joint_command, same)


class Swinging(Recorder):
    """The first arm is on its way to another configuration, or there."""

    there = True

    def __init__(self):
        super().__init__()
        self.resumable = self

    @property
    def state(self):
        joints = self.joints.copy()
        joints[0, 1] += 0.0 if self.there else 1.0
        return RobotState(self.base.copy(), joints)

    def snapshot(self):
        return {"backend.base": self.base, "backend.joints": self.joints}

    def restore(self, snapshot):
        self.base, self.joints = snapshot["backend.base"], snapshot["backend.joints"]
        return self.state


def test_base_and_motion_pause_while_an_arm_reconfigures(solver):
    pausing = ExecutionConfig(arm_settle_timeout=0.5)
    backend, resumed = Swinging(), Swinging()
    loop, other = (make_loop(solver, 2, one, execution=pausing) for one in (backend, resumed))
    backend.there = resumed.there = False
    loop.measure(backend.state)
    moves = []
    for period in range(10):
        if period == 3:
            other.restore(loop.snapshot())
            loop, backend = other, resumed
        backend.there = period == 7
        before = loop.desired
        loop.step(np.ones((2, loop.command_size)))
        moves.append(np.any(loop.desired != before, axis=1).tolist())
        assert np.any(backend.steps[-1][0] != 0.0, axis=1).tolist() == moves[-1]
    paused, free = [False, True], [True, True]
    # For half a second, and later again, since it was there in between.
    assert moves == [paused] * 5 + [free] * 4 + [paused]


class Counter:
    """A policy with a state: counts its calls in each episode."""

    observation_terms = ("joint_positions",)

    def __init__(self):
        self.calls = np.zeros(3, dtype=int)

    def reset(self, rows, n):
        self.calls[rows] = 0

    def act(self, observation):
        self.calls += 1
        return np.zeros((3, 3))


class Halves:
    """A filter that halves commands, and notes which rows it was reset for."""

    def __init__(self):
        self.fresh = []

    def reset(self, rows, n):
        self.fresh.append(rows.tolist())

    def __call__(self, period):
        return period.commanded(0.5 * period.command)


def test_policies_and_filters_are_reset_for_rows_that_begin_anew(solver):
    policy, halves = Counter(), Halves()
    motions = [SubgoalMotion(Linear())]
    loop = assemble(solver, motions, AnalyticBackend(), filters=[halves], policy=policy)
    loop.start(starts(solver.robot, 3), rngs(3))
    np.testing.assert_array_equal(loop.observation.values, loop.robots.joint_positions)
    for _ in range(2):
        loop.step()
    loop.start(starts(solver.robot, 1), rngs(1), np.array([1]))
    assert policy.calls.tolist() == [2, 0, 2]
    assert loop.sequence.periods.tolist() == [2, 0, 2]
    assert halves.fresh == [[0, 1, 2], [1]]


class Ones(Halves):
    def __call__(self, period):
        return period.commanded(np.ones_like(period.command))


def test_filters_apply_in_order(solver):
    sent = []
    for filters in ([Ones(), Halves()], [Halves(), Ones()]):
        recorder = Recorder()
        loop = make_loop(solver, 2, recorder, filters=filters)
        loop.step(still(loop))
        sent.append(recorder.steps[-1][0][:, 5])
    np.testing.assert_allclose(2.0 * sent[0], sent[1])
    assert np.all(sent[1] == solver.robot.base.max_rotation)
    loop = make_loop(solver, 2, filters=[PluginSpec("feasibility"), Halves()])
    before = loop.robots.base_pose
    loop.step(np.ones((2, 3)))
    twist = base_twist(loop.robot.base, before, loop.previous_command, loop.dt)
    moved = spatial.integrate(before, twist, loop.dt)
    np.testing.assert_array_equal(loop.robots.base_pose, moved)


class AtHalfSpeed(Ones):
    def __call__(self, period):
        return period.slowed(np.full(len(period.command), 0.5))


def test_a_motion_that_slows_down_gets_arms_of_its_own(solver):
    arms = []
    for filters in ([AtHalfSpeed()], [PluginSpec("feasibility"), AtHalfSpeed()]):
        loop = make_loop(solver, 8, filters=filters)
        assert loop.step(still(loop)).feasible.all()
        arms.append(loop.robots.joint_positions)
    np.testing.assert_array_equal(*arms)


@pytest.mark.parametrize(("answer", "named"), [
    (lambda command: command[:, :1], "shape"), (lambda command: command[0], "shape"),
    (lambda command: np.full_like(command, np.nan), "finite"), (lambda command: None, "NoneType"),
])  # fmt: skip
def test_wrong_commands_of_a_filter_are_refused(solver, answer, named):
    class Wrong(Ones):
        def __call__(self, period):
            return replace(period, command=answer(period.command))

    loop = make_loop(solver, 2, filters=[Wrong()])
    with pytest.raises(KinfeasError, match=f"command filter Wrong.*{named}"):
        loop.step(still(loop))


def test_exceptions_of_filters_and_policies_name_them(solver):
    class Broken(Counter):
        def __call__(self, period):
            raise LookupError("boom")

        def reset(self, rows, n):
            raise LookupError("boom")

    loop = make_loop(solver, 2)
    loop.set_policy(Broken())
    with pytest.raises(LookupError) as caught:
        loop.start(starts(solver.robot, 2), rngs(2))
    assert raised_by(caught.value) == "policy Broken"
    with pytest.raises(LookupError) as caught:
        make_loop(solver, 2, filters=[Broken()])
    assert raised_by(caught.value) == "command filter Broken"


@pytest.mark.parametrize("terms", [
    {"observation_terms": ("goal_positon",)}, {"observation_terms": "goal_position"},
    {"observation_terms": ()}, {"observation_terms": 5}, {"observation_terms": [["ee_position"]]},
])  # fmt: skip
def test_terms_of_policies_are_known(solver, terms):
    loop, policy = make_loop(solver, 1), Counter()
    vars(policy).update(terms)
    with pytest.raises(KinfeasError, match="policy Counter: 'observation'"):
        loop.set_policy(policy)
