import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinfeas.config import PluginSpec
from kinfeas.core import registry, spatial
from kinfeas.core.backend import RobotState
from kinfeas.core.errors import KinfeasError
from kinfeas.robots.loading import load_robot
from kinfeas.robots.robot import joint_displacement
from kinfeas.sim2real.adapters.adapter import Adapter
from kinfeas.sim2real.deploy.guard_config import Guards
from kinfeas.sim2real.deploy.guards import Clocks, Guarded, check_action
from kinfeas.sim2real.link.drive_limits import to_drive
from kinfeas.sim2real.link.fault import Fault

DT = 0.02
ROBOTS = {name: load_robot(name) for name in ("pr2", "tiago", "hsr")}


class Time:
    """Both clocks, which a test moves on."""

    def __init__(self):
        self.steady = self.wall = 1000.0

    def clocks(self):
        return Clocks(lambda: self.steady, lambda: self.wall)

    def passes(self, seconds):
        self.steady += seconds
        self.wall += seconds


class Puppet:
    """A backend that writes down its commands and measures what a test says."""

    def __init__(self, robot, time):
        self.robot, self.time, self.took = robot, time, DT
        self.sent = []
        self.state = home(robot)

    def reset(self, base_pose, joint_positions, env_ids=None):
        return self.state

    def step(self, base_twist, joint_targets, dt):
        self.sent.append((base_twist.copy(), joint_targets.copy()))
        self.time.passes(self.took)
        return self.state

    def close(self):
        pass


class FollowingPuppet(Puppet):
    """The same with an arm that goes where it is sent."""

    def step(self, base_twist, joint_targets, dt):
        super().step(base_twist, joint_targets, dt)
        self.state = home(self.robot, joint_positions=joint_targets.copy())
        return self.state


class RealTimePuppet(Puppet):
    """The same with a clock of its own."""

    stops = 0

    def read(self):
        return self.state

    def stop(self):
        self.stops += 1


class Aging(RealTimePuppet):
    """The same, which says how old its measurements are."""

    def __init__(self, robot, time):
        super().__init__(robot, time)
        self.state = home(robot, age=np.array([0.0]))


def home(robot, **changes):
    joints = robot.home["home"][np.newaxis]
    return RobotState(**{"base_pose": spatial.IDENTITY[np.newaxis], "joint_positions": joints,
                         **changes})  # fmt: skip


def guarded(robot="pr2", guards=None, kind=Puppet, adapters=()):
    time = Time()
    backend = kind(ROBOTS[robot], time)
    guard = Guarded(backend, ROBOTS[robot], guards, adapters=adapters, clocks=time.clocks())
    guard.reset(backend.state.base_pose, backend.state.joint_positions)
    return guard, backend


def at(x):
    return spatial.planar_pose(*np.array([[x], [0.0], [0.0]]))


def twist(x=0.0, y=0.0, turn=0.0):
    return np.array([[x, y, 0.0, 0.0, 0.0, turn]])


def stays(guard):
    return guard.joint_targets.copy()


def refused(guard, backend, message, command=None, targets=None):
    """Check that a step is refused and that the last command is zero."""
    with pytest.raises(Fault, match=message):
        guard.step(twist() if command is None else command,
                   stays(guard) if targets is None else targets, DT)  # fmt: skip
    if isinstance(backend, RealTimePuppet):
        assert backend.stops
    else:
        assert not backend.sent[-1][0].any()
    with pytest.raises(Fault, match="was stopped"):
        guard.step(twist(0.1), stays(guard), DT)


def test_lets_through_what_is_allowed():
    guard, backend = guarded()
    targets = stays(guard) + 0.01
    for count in range(1, 6):
        command = twist(0.03 * count, 0.01, 0.02)
        guard.step(command, targets, DT)
        np.testing.assert_allclose(backend.sent[-1][0], command, atol=1e-12)
        np.testing.assert_allclose(backend.sent[-1][1], targets, atol=1e-12)


def test_speed_comes_up_to_its_limit_no_faster_than_allowed():
    guard, backend = guarded(guards=Guards(max_linear_velocity=0.1, acceleration=1.0))
    for _ in range(10):
        guard.step(twist(3.0, 4.0, 9.0), stays(guard), DT)
    speeds = [np.hypot(*sent[0, :2]) for sent, _ in backend.sent]
    np.testing.assert_allclose(speeds, np.minimum(0.02 * np.arange(1, 11), 0.1))
    np.testing.assert_allclose(backend.sent[-1][0][0, :2], [0.06, 0.08])


def test_no_setting_exceeds_the_robots_own_limits():
    guard, backend = guarded(
        guards=Guards(max_linear_velocity=9.0, acceleration=99.0, max_angular_velocity=9.0)
    )
    for _ in range(20):
        guard.step(twist(3.0), stays(guard), DT)
    assert backend.sent[-1][0][0, 0] == pytest.approx(ROBOTS["pr2"].base.max_velocity)


def test_a_jump_of_the_arm_is_slowed():
    guard, backend = guarded(guards=Guards(joint_speed=0.5), kind=FollowingPuppet)
    before, velocity = stays(guard), ROBOTS["pr2"].max_joint_velocity
    targets = before.copy()
    targets[0, [1, 3]] -= [0.8, 0.4]
    for _ in range(100):
        last = stays(guard)
        guard.step(twist(), targets, DT)
        moved = backend.sent[-1][1] - last
        assert np.all(np.abs(moved) <= 0.5 * velocity * DT * (1.0 + 1e-9))
        assert moved[0, 1] == pytest.approx(2.0 * moved[0, 3])
    np.testing.assert_allclose(backend.sent[-1][1], targets)


def test_a_huge_jump_is_refused_and_ends_the_run():
    guard, backend = guarded(guards=Guards(joint_jump=2.0, max_consecutive_ik_failures=3))
    before = stays(guard)
    targets = before.copy()
    targets[0, 4] = spatial.wrap(targets[0, 4] + 2.5)
    for _ in range(3):
        guard.step(twist(), targets, DT)
        np.testing.assert_array_equal(backend.sent[-1][1], before)
        guard.judge(feasible=True)
    guard.step(twist(0.01), targets, DT)
    with pytest.raises(Fault, match="target is too far away, for more than 3 steps in a row"):
        guard.judge(feasible=True)
    assert not backend.sent[-1][0].any()


def test_an_arm_that_does_not_follow_is_sent_no_farther_and_ends_the_run():
    guard, backend = guarded(guards=Guards(max_tracking_delay=0.11, max_consecutive_ik_failures=3))
    max_linear_velocity = ROBOTS["pr2"].max_joint_velocity
    targets = stays(guard)
    targets[0, 3] += 1.0
    with pytest.raises(Fault, match="joint r_elbow_flex_joint does not follow, for more than 3"):
        for _ in range(20):
            guard.step(twist(0.01), targets, DT)
            guard.judge(feasible=True)
    away = np.abs(backend.sent[-1][1] - backend.state.joint_positions)[0]
    assert np.all(away <= (0.11 + DT) * max_linear_velocity)
    assert len(backend.sent) == 6 + 4 + 1
    assert not backend.sent[-1][0].any()


def test_an_arm_that_lags_is_waited_for():
    guard, backend = guarded(guards=Guards(max_tracking_delay=0.1, max_consecutive_ik_failures=3))
    targets = stays(guard)
    targets[0, 3] += 1.0
    slow = 0.4 * DT * ROBOTS["pr2"].max_joint_velocity[3]
    for _ in range(60):
        guard.step(twist(), targets, DT)
        guard.judge(feasible=True)
        joints = backend.state.joint_positions.copy()
        joints[0, 3] = min(joints[0, 3] + slow, targets[0, 3])
        backend.state = home(ROBOTS["pr2"], joint_positions=joints)
    np.testing.assert_allclose(backend.sent[-1][1], targets)


def test_a_continuous_joint_goes_the_short_way():
    guard, _ = guarded(guards=Guards(joint_jump=0.5))
    guard.joint_targets[0, 4] = math.pi - 0.01
    targets = stays(guard)
    targets[0, 4] = -math.pi + 0.01
    guard.step(twist(), targets, DT)
    np.testing.assert_allclose(guard.joint_targets, targets)


def test_targets_beyond_the_limits_are_clipped():
    guard, backend = guarded(kind=FollowingPuppet)
    targets = stays(guard)
    targets[0, 1] += 1.0
    for _ in range(100):
        guard.step(twist(), targets, DT)
    assert backend.sent[-1][1][0, 1] == ROBOTS["pr2"].arm[1].upper


def test_steps_without_a_solution_end_the_run_if_they_follow_each_other():
    guard, backend = guarded(guards=Guards(max_consecutive_ik_failures=2))
    for feasible in (False, False, True, False, False):
        guard.step(twist(0.01), stays(guard), DT)
        guard.judge(feasible=feasible)
    guard.step(twist(0.01), stays(guard), DT)
    with pytest.raises(Fault, match="IK finds no solution, for more than 2 steps in a row"):
        guard.judge(feasible=False)
    assert not backend.sent[-1][0].any()


TILTED = np.array([[0.0, 0.0, 0.0, 0.2, 0.0, 0.0, np.sqrt(0.96)]])
BENT = ROBOTS["pr2"].home["home"] + np.array([0.0, 0.3, 0.0, 0.0, 0.0, 0.0, 0.0])


@pytest.mark.parametrize(("changes", "message"), [
    ({"base_pose": np.full((1, 7), np.nan)}, "base pose is not finite"),
    ({"joint_positions": np.full((1, 7), np.inf)}, "r_shoulder_pan_joint is not finite"),
    ({"joint_positions": BENT[np.newaxis]}, "r_shoulder_lift_joint is measured 0.23 beyond"),
    ({"base_pose": spatial.IDENTITY[np.newaxis] * 0.9}, "not a unit quaternion"),
    ({"base_pose": TILTED}, "leans by 0.40 rad, at most 0.15 rad is allowed"),
    ({"base_pose": spatial.IDENTITY[np.newaxis] + [[0.5, 0, 0, 0, 0, 0, 0]]}, "jumped by 0.50 m"),
    ({"base_pose": spatial.planar_pose(*np.zeros((2, 1)), np.ones(1))}, "jumped by 1.00 rad"),
    ({"age": np.array([0.21])}, "0.21 s old, at most 0.2 s is allowed"),
    ({"age": np.array([-0.2])}, "0.20 s in the future"),
    ({"age": np.array([np.nan])}, "age of the measurements is not finite"),
    ({"ee_in_base": np.full((1, 7), np.nan)}, "EE pose is not finite"),
])  # fmt: skip
def test_measurements_that_cannot_be_believed_stop_the_base(changes, message):
    guard, backend = guarded()
    guard.step(twist(0.02), stays(guard), DT)
    backend.state = home(ROBOTS["pr2"], **changes)
    refused(guard, backend, message, twist(0.04))


def test_the_base_may_not_leave_for_good():
    guard, backend = guarded(guards=Guards(max_distance=1.0))
    for x in np.arange(0.2, 1.1, 0.2):
        backend.state = home(
            ROBOTS["pr2"], base_pose=spatial.planar_pose(*[np.array([v]) for v in (x, 0.0, 0.0)])
        )
        guard.step(twist(0.1), stays(guard), DT)
    backend.state = home(
        ROBOTS["pr2"], base_pose=spatial.planar_pose(*[np.array([v]) for v in (1.2, 0.0, 0.0)])
    )
    refused(guard, backend, "1.20 m from its start")


def test_a_message_shows_that_a_small_limit_was_passed():
    guard, backend = guarded(guards=Guards(max_distance=0.01))
    backend.state = home(ROBOTS["pr2"], base_pose=at(0.0123))
    refused(guard, backend, r"is 0\.012 m from its start, at most 0\.01 m is allowed")


@pytest.mark.parametrize(("command", "targets", "message"), [
    (twist(math.nan), None, "command for the base is not finite"),
    (None, np.full((1, 7), math.inf), "command for the arm is not finite"),
    (np.zeros((1, 3)), None, "command has the shapes"),
    (None, np.zeros((1, 8)), "command has the shapes"),
])  # fmt: skip
def test_commands_that_are_none_stop_the_base(command, targets, message):
    guard, backend = guarded()
    guard.step(twist(0.02), stays(guard), DT)
    refused(guard, backend, message, command, targets)


def test_a_stall_before_the_command_and_one_after_it():
    guard, backend = guarded()
    guard.step(twist(0.02), stays(guard), DT)
    backend.time.passes(0.5)
    refused(guard, backend, "made of a measurement 0.50 s old")
    guard, backend = guarded()
    guard.step(twist(0.02), stays(guard), DT)
    backend.took = 0.5
    refused(guard, backend, "control period took 0.50 s")


@pytest.mark.parametrize(("clock", "by", "message"), [
    ("steady", -1.0, "clock went backwards by 1.00 s"),
    ("wall", -1.0, r"system's clock was set by -1\.00 s"),
    ("wall", 3.0, r"system's clock was set by \+3\.00 s"),
])  # fmt: skip
def test_a_clock_that_jumps_stops_the_base(clock, by, message):
    guard, backend = guarded()
    guard.step(twist(0.02), stays(guard), DT)
    setattr(backend.time, clock, getattr(backend.time, clock) + by)
    refused(guard, backend, message)


class Slow(Adapter):
    """An adapter that takes its time with a command."""

    def modify_command(self, twist, targets, dt):
        self.backend.backend.time.passes(0.3)
        return twist, targets


class Keeping(Slow):
    """A backend around a backend that keeps commands to itself."""

    def step(self, base_twist, joint_targets, dt):
        return self.backend._state


class Swallowing(Slow):
    """One that knows better than those that it is wrapped around."""

    def step(self, base_twist, joint_targets, dt):
        try:
            return super().step(base_twist, joint_targets, dt)
        except Fault:
            return self.backend._state


class Ageless(Slow):
    """One that measures times in words."""

    def modify_command(self, twist, targets, dt):
        return twist, targets

    def modify_state(self, state):
        return replace(state, age="old")


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        (Slow, r"the command is made of a measurement 0\.30 s old, at most 0\.2 s is allowed"),
        (Keeping, "an adapter has not passed the command on"),
        (Swallowing, "an adapter has not passed the command on"),
    ],
)
def test_what_an_adapter_does_to_a_command_makes_no_stale_one(monkeypatch, kind, message):
    guard, backend = adapted(monkeypatch, kind)
    refused(guard, backend, message, twist(0.02))
    assert backend.sent == []


def test_an_age_that_an_adapter_makes_no_number_of_is_not_believed(monkeypatch):
    with pytest.raises(Fault, match="the age of the measurements is no array of one number"):
        adapted(monkeypatch, Ageless)


def adapted(monkeypatch, kind):
    """Return guards within which an adapter stands around a live robot, and that."""
    monkeypatch.setattr(registry, "_REGISTERED", [])
    registry.register("kinfeas.adapters", "mine", kind)
    return guarded(kind=Aging, adapters=[PluginSpec("mine")])


def test_what_is_simulated_grows_no_older_while_an_adapter_thinks(monkeypatch):
    monkeypatch.setattr(registry, "_REGISTERED", [])
    registry.register("kinfeas.adapters", "mine", Slow)
    never = Guards().timeless()
    guard, backend = guarded(guards=never, adapters=[PluginSpec("mine")])
    guard.step(twist(0.02), stays(guard), DT)
    assert backend.sent


def test_a_live_robot_must_say_how_old_its_measurements_are():
    with pytest.raises(Fault, match="does not say how old"):
        guarded(kind=RealTimePuppet)


def test_an_error_of_any_kind_stops_the_base():
    guard, backend = guarded()

    def breaks(*_):
        backend.step = type(backend).step.__get__(backend)
        raise ZeroDivisionError

    backend.step = breaks
    with pytest.raises(ZeroDivisionError):
        guard.step(twist(0.01), stays(guard), DT)
    assert guard.stopped
    assert not backend.sent[-1][0].any()


def test_a_stop_that_fails_hides_no_reason():
    guard, backend = guarded()

    def breaks(*_):
        raise KinfeasError("the link is broken")

    backend.step = breaks
    with pytest.raises(KinfeasError, match="the link is broken"):
        guard.step(twist(0.01), stays(guard), DT)
    assert guard.unstopped == "the link is broken"


def test_a_stop_that_fails_in_any_way_is_told():
    guard, backend = guarded()

    def breaks(*_):
        raise RuntimeError("the bus is gone")

    guard.step(twist(0.01), stays(guard), DT)
    backend.step = breaks
    guard.stop()
    assert guard.unstopped == "the bus is gone"


class OwnError(Exception):
    """What a plugin's author may think up."""


def test_a_robot_that_neither_stops_nor_lets_go_is_told_once():
    guard, backend = guarded(kind=FollowingPuppet)

    def breaks(*_):
        raise OwnError("the bus is gone")

    guard.step(twist(0.01), stays(guard), DT)
    backend.step = backend.close = breaks
    guard.close()
    assert (guard.unstopped, guard.unclosed) == ("the bus is gone", "")


@pytest.mark.parametrize(
    "name", ["base_noise", "actuator_lag", "command_latency", "dropped_commands"]
)
def test_adapters_do_not_get_beyond_the_limits(name):
    adapter = PluginSpec(name, {"base_noise": {"linear": 0.5, "angular": 0.5}}.get(name, {}))
    guards = Guards(max_linear_velocity=0.05, max_angular_velocity=0.1)
    guard, backend = guarded(guards=guards, adapters=[adapter])
    guard.seed(np.array([1], dtype=np.uint64), np.array([0]))
    for _ in range(40):
        guard.step(twist(1.0, 0.0, 1.0), stays(guard), DT)
    before = np.zeros(6)
    most = ROBOTS["pr2"].base.max_acceleration * DT
    for sent, _ in backend.sent:
        assert np.hypot(*sent[0, :2]) <= 0.05 + 1e-9
        assert abs(sent[0, 5]) <= 0.1 + 1e-9
        assert np.hypot(*(sent[0] - before)[:2]) <= most + 1e-9
        before = sent[0]
    guard.stop()
    assert not backend.sent[-1][0].any()


class Scribbling(Puppet):
    """The same, which writes into what it is given."""

    def step(self, base_twist, joint_targets, dt):
        state = super().step(base_twist, joint_targets, dt)
        base_twist += 9.0
        joint_targets += 9.0
        return state


def test_a_backend_that_writes_into_commands_changes_no_later_one():
    guard, backend = guarded(kind=Scribbling)
    command, targets = twist(0.02), stays(guard)
    for _ in range(3):
        guard.step(command, targets, DT)
        np.testing.assert_allclose(guard.base_twist, twist(0.02))
        np.testing.assert_allclose(guard.joint_targets, targets)
    np.testing.assert_allclose(backend.sent[-1][1], targets)


def test_an_arm_that_is_lost_is_sent_nowhere():
    # As above: an adapter may keep it from the guards of measurements for a while.
    guard, backend = guarded(adapters=[PluginSpec("sensor_latency", {"seconds": 0.1})])
    lost = np.full((1, len(ROBOTS["pr2"].arm)), np.nan)
    backend.state, targets = home(ROBOTS["pr2"], joint_positions=lost), stays(guard)
    targets[0, 3] += 0.5
    for _ in range(3):
        guard.step(twist(), targets, DT)
    np.testing.assert_array_equal(backend.sent[-1][1], backend.sent[0][1])


class Forming(Puppet):
    """One that plans the arm's way itself."""

    limit = None

    def limit_arm(self, velocity):
        self.limit = velocity


def test_whoever_plans_the_arms_way_is_told_how_fast_it_may_go():
    _, backend = guarded(guards=Guards(joint_speed=0.25), kind=Forming)
    np.testing.assert_allclose(backend.limit, 0.25 * ROBOTS["pr2"].max_joint_velocity)


@pytest.mark.filterwarnings("ignore:invalid value")
def test_a_measurement_that_is_not_finite_makes_no_command():
    # An adapter may keep it from the guards of measurements for a while.
    guard, backend = guarded(adapters=[PluginSpec("sensor_latency", {"seconds": 0.1})])
    backend.state = home(ROBOTS["pr2"], base_pose=np.full((1, 7), np.nan))
    guard.step(twist(0.02), stays(guard), DT)
    with pytest.raises(Fault, match="command for the base is not finite"):
        guard.step(twist(0.02), stays(guard), DT)
    assert all(np.isfinite(sent).all() for sent, _ in backend.sent)
    assert not backend.sent[-1][0].any()


class Hand(Puppet):
    """The same with a gripper."""

    grips = 0

    def grip(self, grip, env_ids):
        self.grips += 1


def test_a_gripper_does_nothing_after_a_stop():
    guard, backend = guarded(kind=Hand)
    guard.grip("close", np.array([0]))
    guard.stop()
    with pytest.raises(Fault, match="was stopped"):
        guard.grip("open", np.array([0]))
    assert backend.grips == 1


def test_what_has_not_moved_yet_needs_no_stop():
    guard, backend = guarded()
    guard.stop()
    assert guard.stopped
    assert not backend.sent
    assert guard.unstopped == ""


def test_a_policys_action_is_looked_at():
    action = np.zeros((1, 3))
    assert check_action(action, 3) is action
    with pytest.raises(Fault, match="has the shape"):
        check_action(action, 2)
    with pytest.raises(Fault, match="not finite"):
        check_action(action * np.nan, 3)


def test_the_rate_must_suit_the_guards():
    Guards().check_rate(0.1)
    with pytest.raises(KinfeasError, match=r"needs a rate of at least 7\.5 Hz, not 5 Hz"):
        Guards().check_rate(0.2)


anything = st.floats(width=32) | st.floats(-3.0, 3.0)
some_steps = st.lists(
    st.tuples(
        st.tuples(*[anything] * 6),  # twist
        st.lists(anything, min_size=8, max_size=8),  # joint targets
        st.floats(-0.1, 0.3),  # age
        st.tuples(*[st.floats(-0.3, 0.3) | anything] * 2, st.floats(-4.0, 4.0)),  # measured base
        st.floats(0.0, 0.3),  # time that passes
    ),
    min_size=1,
    max_size=12,
)


@given(st.sampled_from(sorted(ROBOTS)), some_steps)
def test_whatever_happens_what_goes_out_obeys_the_limits_or_is_zero(name, steps):
    robot, guards = ROBOTS[name], Guards(max_linear_velocity=0.15, acceleration=1.0)
    guard, backend = guarded(name, guards)
    j, poses = len(robot.arm), []
    for command, targets, age, (x, y, heading), took in steps:
        poses.append(guard.state.base_pose[0])
        pose = spatial.planar_pose(*np.array([[x], [y], [heading]]))
        backend.state = replace(home(robot), base_pose=pose, age=np.array([age]))
        backend.took = took
        try:
            guard.step(np.array([command]), np.array([targets[:j]]), DT)
        except Fault:
            break
    lower, upper = robot.joint_limits
    before, arm = np.zeros(3), home(robot).joint_positions[0]
    for (sent, joints), pose in zip(backend.sent, [*poses, poses[-1]], strict=False):
        assert np.isfinite(sent).all()
        assert np.isfinite(joints).all()
        drive = to_drive(robot.base, pose, sent[0], DT)
        near = 1e-9
        if sent.any():
            assert np.hypot(*drive[:2]) <= 0.15 + near
            assert abs(drive[2]) <= robot.base.max_rotation + near
            change = np.abs(drive - before)
            assert np.hypot(*change[:2]) <= 1.0 * DT + near
            assert change[2] <= robot.base.max_rotation_acceleration * DT + near
        if robot.base.drive == "differential":
            assert abs(drive[1]) <= near
        moved = np.abs(joint_displacement(robot, arm, joints[0]))
        assert np.all(moved <= robot.max_joint_velocity * DT + near)
        assert np.all((joints[0] >= lower - near) & (joints[0] <= upper + near))
        before, arm = drive, joints[0]
    if guard.stopped and backend.sent:
        assert not backend.sent[-1][0].any()
