import math
from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinfeas.config import PluginSpec, registry
from kinfeas.core import spatial
from kinfeas.core.backend import SCAN_BEAMS, Backend, RobotState, Scan
from kinfeas.core.errors import Fault, KinfeasError
from kinfeas.kinematics.drive import base_velocity
from kinfeas.robots.loading import load_robot
from kinfeas.robots.robot import joint_displacement
from kinfeas.sim2real.adapters.adapter import Adapter
from kinfeas.sim2real.deploy.config import Guards
from kinfeas.sim2real.deploy.guards import Guarded
from kinfeas.sim2real.link.scans import ANGLES
from tests.builders import at, twist
from tests.sim2real.conftest import Time

DT = 0.02
ROBOTS = {name: load_robot(name) for name in ("pr2", "tiago", "hsr")}
PR2 = ROBOTS["pr2"]


class Double(Backend):
    """A robot that measures what a test sets, in real time if it is `live`."""

    def __init__(self, robot=PR2, live=False, follows=False, **abilities):
        self.time, self.took, self.follows, self.sent = Time(), DT, follows, []
        self.state = home(robot, age=np.zeros(1) if live else None)
        self.real_time = Mock(read=lambda: self.state) if live else None
        vars(self).update(abilities)

    def reset(self, base_pose, joint_positions, env_ids=None):
        return self.state

    def step(self, base_twist, joint_targets, dt):
        self.sent.append((base_twist.copy(), joint_targets.copy()))
        if self.follows:
            self.state = replace(self.state, joint_positions=joint_targets.copy())
        base_twist += 9.0  # which must not change later commands
        joint_targets += 9.0
        self.time.passes(self.took)
        return self.state

    def close(self):
        pass


def home(robot=PR2, **changes):
    state = RobotState(spatial.IDENTITY[np.newaxis], robot.home["home"][np.newaxis])
    return replace(state, **changes)


def guarded(guards=None, robot=PR2, adapters=(), **backend):
    backend = Double(robot, **backend)
    guard = Guarded(backend, robot, guards, adapters=adapters, clock=backend.time.clock)
    guard.reset(backend.state.base_pose, backend.state.joint_positions)
    return guard, backend


def arm(guard, joint=0, by=0.0):
    """Return the last targets, with one joint changed."""
    targets = guard.commands.joint_targets.copy()
    targets[0, joint] += by
    return targets


def stops(guard, backend, message, command=None, targets=None):
    """Check that a step raises, that the robot is stopped, and stays so."""
    targets = arm(guard) if targets is None else targets
    with pytest.raises(KinfeasError, match=message):
        guard.step(twist() if command is None else command, targets, DT)
    if backend.real_time:
        assert backend.real_time.stop.called
    else:
        assert not backend.sent[-1][0].any()
    with pytest.raises(Fault):
        guard.step(twist(0.1), arm(guard), DT)


def test_passes_commands_within_the_limits_to_the_bit():
    guard, backend = guarded()
    targets = arm(guard) + 0.01 / 3.0
    for count in range(1, 6):
        guard.step(twist(0.03 * count, 0.01, 0.02), targets, DT)
        np.testing.assert_array_equal(backend.sent[-1][0], twist(0.03 * count, 0.01, 0.02))
        np.testing.assert_array_equal(backend.sent[-1][1], targets)
    stops(guard, backend, "base command", np.zeros((1, 3)))
    guard.reset(None, None)
    stops(guard, backend, "arm command", targets=np.full((1, 7), math.inf))


LIMITS = "max_linear_velocity", "acceleration", "max_angular_velocity", "rotation_acceleration"
OWN = "max_velocity", "max_acceleration", "max_rotation", "max_rotation_acceleration"


@pytest.mark.parametrize("limits", [(0.1, 1.0, 0.1, 1.0), (9.0, 99.0, 9.0, 99.0)])
def test_velocity_and_acceleration_are_limited_by_guards_and_robot_but_for_brakes(limits):
    lower = zip(limits, (getattr(PR2.base, name) for name in OWN), strict=True)
    speed, acceleration, turn, rotation = map(min, lower)
    guard, backend = guarded(Guards(**dict(zip(LIMITS, limits, strict=True))))
    for _ in range(40):
        guard.step(twist(3.0, 4.0, -9.0), arm(guard), DT)
    guard.commands.brake = True  # at once
    guard.step(twist(3.0), arm(guard), DT)
    assert not backend.sent.pop()[0].any()
    sent, steps = np.array([sent[0] for sent, _ in backend.sent]), DT * np.arange(1, 41)
    np.testing.assert_allclose(np.hypot(*sent[:, :2].T), np.minimum(steps * acceleration, speed))
    np.testing.assert_allclose(sent[:, 5], -np.minimum(steps * rotation, turn))


def test_a_jump_of_the_arm_becomes_a_motion_at_its_speed():
    guard, backend = guarded(Guards(joint_speed=0.5), live=True, follows=True)
    (limit,) = backend.real_time.limit_arm.call_args.args
    np.testing.assert_allclose(limit, 0.5 * PR2.max_joint_velocity)
    targets = arm(guard)
    targets[0, [1, 3]] -= [0.8, 0.4]
    for _ in range(100):
        last = arm(guard)
        guard.step(twist(), targets, DT)
        moved = backend.sent[-1][1] - last
        assert np.all(np.abs(moved) <= 0.5 * PR2.max_joint_velocity * DT * (1.0 + 1e-9))
        assert moved[0, 1] == pytest.approx(2.0 * moved[0, 3])
    np.testing.assert_allclose(backend.sent[-1][1], targets)


def test_joint_targets_stay_within_their_limits():
    guard, backend = guarded(Guards(measured_joint_jump=math.pi), follows=True)
    targets = arm(guard, 1, 1.0)
    for _ in range(100):
        guard.step(twist(), targets, DT)
    assert backend.sent[-1][1][0, 1] == PR2.arm[1].upper
    guard.commands.joint_targets[0, 4] = math.pi - 0.01  # continuous: it takes the short way
    targets = arm(guard)
    targets[0, 4] = -math.pi + 0.01
    guard.step(twist(), targets, DT)
    np.testing.assert_allclose(guard.commands.joint_targets, targets)
    # A joint that starts beyond a limit does not jump to it.
    beyond = PR2.home["home"].copy()
    for start, by in ((PR2.arm[1].upper + 0.05, 0.1), (PR2.arm[1].lower - 0.05, -0.1)):
        beyond[1] = start
        backend.state = home(joint_positions=beyond[np.newaxis])
        guard.reset(None, None)
        for further in (0.0, by):
            guard.step(twist(), arm(guard, 1, further), DT)
            assert backend.sent[-1][1][0, 1] == start


@pytest.mark.parametrize(("guards", "joint", "by", "named"), [
    (Guards(joint_jump=2.0, max_consecutive_ik_failures=3), 4, 2.5, "too far"),
    (Guards(max_tracking_delay=0.11, max_consecutive_ik_failures=3), 3, 1.0, "r_elbow_flex"),
])  # fmt: skip
def test_an_arm_that_cannot_go_on_holds_until_the_run_ends(guards, joint, by, named):
    guard, backend = guarded(guards)
    targets = arm(guard, joint, by)
    with pytest.raises(Fault, match=named):
        for _ in range(20):
            guard.step(twist(0.01), targets, DT)
            guard.count(feasible=True)
    away = np.abs(backend.sent[-1][1] - backend.state.joint_positions)[0]
    moved = 0 if joint == 4 else 6
    assert np.all(away <= (0.11 + DT) * PR2.max_joint_velocity * (moved > 0))
    assert len(backend.sent) == moved + 4 + 1
    assert not backend.sent[-1][0].any()


def test_only_ik_failures_in_a_row_end_the_run():
    guard, backend = guarded(Guards(max_consecutive_ik_failures=2))
    for feasible in (False, False, True, False, False):
        guard.step(twist(0.01), arm(guard), DT)
        guard.count(feasible=feasible)
    guard.step(twist(0.01), arm(guard), DT)
    with pytest.raises(Fault):
        guard.count(feasible=False)
    assert not backend.sent[-1][0].any()


TILTED = np.array([[0.0, 0.0, 0.0, 0.08, 0.0, 0.0, np.sqrt(1.0 - 0.08**2)]])  # by 0.16 rad
BENT = PR2.home["home"] + np.array([0.0, 0.3, 0.0, 0.0, 0.0, 0.0, 0.0])
JUMPED = PR2.home["home"] + 0.8 * np.eye(7)[4]
BELOW = np.where(np.arange(7) == 1, PR2.arm[1].lower - 0.11, PR2.home["home"])


@pytest.mark.parametrize(("changes", "named"), [
    ({"base_pose": np.full((1, 7), np.nan)}, "base_pose is not finite"),
    ({"joint_positions": BENT[np.newaxis]}, "r_shoulder_lift_joint"),
    ({"joint_positions": np.array([BELOW])}, "r_shoulder_lift_joint"),
    ({"base_pose": spatial.IDENTITY[np.newaxis] * 0.9}, "unit quaternion"),
    ({"base_pose": TILTED}, "leans"),
    ({"base_pose": at(0.5)}, "jumped by 0.5 m"),
    ({"base_pose": at(yaw=1.0)}, "jumped by 1 rad"),
    ({"joint_positions": JUMPED[np.newaxis]}, "r_forearm_roll_joint jumped by 0.8"),
    ({"age": np.array([0.21])}, "0.21 s old"),
    ({"age": np.array([-0.2])}, "in the future"),
    ({"age": np.array([np.nan])}, "old"),
])  # fmt: skip
def test_measurements_beyond_the_limits_stop_the_robot(changes, named):
    guard, backend = guarded(live=True)
    assert guard.read() is backend.state
    guard.step(twist(0.02), arm(guard), DT)
    backend.state = replace(backend.state, **changes)
    stops(guard, backend, named, twist(0.04))
    if "jumped" not in named:  # before a run, too
        with pytest.raises(KinfeasError, match=named):
            guard.read()


@pytest.mark.parametrize(("allowed", "beyond", "named"), [
    ([at(0.325), at(0.65), at(0.975)], at(1.01), "from its start"),
    ([], at(0.335), "jumped by 0.335 m"),
    ([at(yaw=0.64)], at(yaw=1.3), "jumped by 0.66 rad"),
])  # fmt: skip
def test_the_base_may_be_measured_where_it_can_have_driven(allowed, beyond, named):
    guard, backend = guarded(Guards(max_distance=1.0))
    backend.took = 0.15  # s, in which the base drives 3 cm and turns by 0.15 rad
    for pose in allowed:
        backend.state = home(base_pose=pose)
        guard.step(twist(0.02), arm(guard), DT)
    backend.state = home(base_pose=beyond)
    stops(guard, backend, named, twist(0.04))


@pytest.mark.parametrize("live", [False, True])
def test_a_stall_before_a_command_or_after_it_stops_the_robot(live):
    guard, backend = guarded(live=live)
    guard.step(twist(0.02), arm(guard), DT)
    backend.time.passes(0.5)
    sent = len(backend.sent)
    stops(guard, backend, "made of a measurement 0.5 s old", twist(0.02))
    assert not any(command.any() for command, _ in backend.sent[sent:])
    guard, backend = guarded(live=live)
    backend.took = 0.5
    stops(guard, backend, "control period took 0.5 s")


def test_an_old_measurement_and_a_short_stall_add_up():
    guard, backend = guarded(live=True)
    backend.state = home()  # of a real robot, without an age
    stops(guard, backend, "age")
    guard, backend = guarded(live=True)
    backend.state = home(age=np.array([0.15]))
    guard.step(twist(0.02), arm(guard), DT)
    backend.time.passes(0.1)
    stops(guard, backend, "made of a measurement 0.25 s old", twist(0.02))
    assert len(backend.sent) == 1


@pytest.mark.parametrize("by", [-1.0, 3.0])
def test_a_system_clock_that_is_set_stops_the_robot(by):
    guard, backend = guarded()
    guard.step(twist(0.02), arm(guard), DT)
    backend.time.wall += by
    stops(guard, backend, "clock")


class Slow(Adapter):
    def modify_command(self, twist, targets, dt):
        self.backend.backend.time.passes(0.3)
        return twist, targets


class Keeping(Adapter):
    def step(self, base_twist, joint_targets, dt):
        return self.backend._state


class Hiding(Adapter):
    def modify_state(self, state):
        return home(age=np.zeros(1))


@pytest.mark.filterwarnings("ignore:invalid value")
@pytest.mark.parametrize(
    ("kind", "named"), [(Slow, "0.3 s old"), (Keeping, "has not passed"), (Hiding, "base command")]
)
@pytest.mark.usefixtures("unregistered")
def test_no_adapter_makes_a_command_late_drops_it_or_hides_a_fault(kind, named):
    registry.register("kinfeas.adapters", "mine", kind)
    guard, backend = guarded(live=True, adapters=[PluginSpec("mine")])
    if kind is Hiding:
        backend.state = replace(backend.state, base_pose=backend.state.base_pose * np.nan)
        guard.step(twist(0.02), arm(guard), DT)
    stops(guard, backend, named, twist(0.02))
    assert len(backend.sent) == (kind is Hiding)


@pytest.mark.parametrize("error", [ZeroDivisionError("boom"), SystemExit("boom")])
def test_any_error_stops_the_robot_and_a_failing_stop_is_reported(error):
    guard, backend = guarded()
    guard.step(twist(0.01), arm(guard), DT)
    backend.step = Mock(side_effect=[error, backend.state])
    with pytest.raises(type(error)):
        guard.step(twist(0.02), arm(guard), DT)
    assert guard.commands.stopped
    assert not backend.step.call_args.args[0].any()
    guard.reset(None, None)
    backend.step = Mock(side_effect=[backend.state, error])
    backend.close = Mock(side_effect=error)
    guard.step(twist(0.01), arm(guard), DT)
    guard.close()
    assert (guard.unstopped, guard.unclosed) == ("boom", "")


def test_a_stopped_simulation_is_commanded_once_and_its_gripper_does_nothing():
    guard, backend = guarded(gripper=Mock())
    guard.gripper.grip("close", np.array([0]))
    guard.stop()
    with pytest.raises(Fault):
        guard.gripper.grip("open", np.array([0]))
    backend.gripper.grip.assert_called_once()
    assert backend.sent == []  # since nothing has moved
    guard.reset(None, None)
    guard.step(twist(0.01), arm(guard), DT)
    for end in (guard.stop, guard.stop, guard.close):
        end()
    assert [bool(base.any()) for base, _ in backend.sent] == [True, False]


def test_a_rate_below_the_limits_of_time_is_an_error():
    Guards().check_rate(0.1)
    with pytest.raises(KinfeasError, match="max_age"):
        Guards().check_rate(0.2)


anything = st.floats(width=32) | st.floats(-3.0, 3.0)
a_step = st.tuples(
    st.tuples(*[anything] * 6),  # twist
    st.lists(anything, min_size=8, max_size=8),  # joint targets
    st.floats(-0.1, 0.3),  # age
    st.tuples(*[st.floats(-0.3, 0.3) | anything] * 2, st.floats(-4.0, 4.0)),  # measured base
    st.floats(0.0, 0.3),  # time that passes
)
some_steps = st.lists(a_step, min_size=1, max_size=12)
NOISE = PluginSpec("base_noise", {"linear": 0.5, "angular": 0.5})


@given(st.sampled_from(sorted(ROBOTS)), some_steps, st.sampled_from([(), (NOISE,)]))
def test_every_command_is_within_the_limits_or_zero(name, steps, adapters):
    robot, guards = ROBOTS[name], Guards(max_linear_velocity=0.15, acceleration=1.0)
    guard, backend = guarded(guards, robot, adapters)
    j, poses = len(robot.arm), []
    for command, targets, age, (x, y, heading), took in steps:
        poses.append(guard.state.base_pose)
        backend.state = home(robot, base_pose=at(x, y, heading), age=np.array([age]))
        backend.took = took
        try:
            guard.step(np.array([command]), np.array([targets[:j]]), DT)
        except KinfeasError:
            break
    lower, upper = robot.joint_limits
    before, joints_before = np.zeros(3), home(robot).joint_positions[0]
    for (sent, joints), pose in zip(backend.sent, [*poses, poses[-1]], strict=False):
        assert np.isfinite(sent).all()
        assert np.isfinite(joints).all()
        drive, near = base_velocity(robot.base, pose, sent, DT)[0], 1e-9
        if sent.any():
            assert np.hypot(*drive[:2]) <= 0.15 + near
            assert abs(drive[2]) <= robot.base.max_rotation + near
            change = np.abs(drive - before)
            assert np.hypot(*change[:2]) <= 1.0 * DT + near
            assert change[2] <= robot.base.max_rotation_acceleration * DT + near
        if robot.base.drive == "differential":
            assert abs(drive[1]) <= near
        moved = np.abs(joint_displacement(robot, joints_before, joints[0]))
        assert np.all(moved <= robot.max_joint_velocity * DT + near)
        assert np.all((joints[0] >= lower - near) & (joints[0] <= upper + near))
        before, joints_before = drive, joints[0]
    if guard.commands.stopped and backend.sent:
        assert not backend.sent[-1][0].any()


def scanning(adapters=(), **changes):
    """Return guards, their backend and its scan, which is blind nowhere."""
    scan = Scan(np.ones((1, 2, SCAN_BEAMS)), np.zeros(SCAN_BEAMS, dtype=bool))
    scanner = Mock(scan=Mock(return_value=replace(scan, **changes)))
    return *guarded(live=True, adapters=adapters, scanner=scanner), scanner.scan.return_value


@pytest.mark.parametrize(("age", "blind"), [(0.6, False), (0.0, True), (np.inf, False)])
def test_an_old_or_blind_scan_stops_the_robot_that_uses_it(age, blind):
    assert guarded()[0].scanner is None
    guard, _, scan = scanning()
    assert guard.scanner.scan() is scan
    guard, backend, _ = scanning(age=age, blind=np.full(SCAN_BEAMS, blind))
    guard.step(twist(0.01), arm(guard), DT)  # a policy without scans may go on
    with pytest.raises(Fault, match="scan"):
        guard.scanner.scan()
    assert backend.real_time.stop.called


@pytest.mark.parametrize("adapters", [(), (PluginSpec("scan_noise"),)])
def test_the_base_does_not_drive_where_its_scan_is_blind(adapters):
    guard, backend, scan = scanning(adapters, blind=np.abs(ANGLES) > 0.5 * np.pi)
    measure = backend.scanner.scan
    guard.scanner.scan()
    measure.return_value = replace(scan, blind=None)
    guard.scanner.scan()
    guard.step(twist(-0.03), arm(guard), DT)
    measure.return_value = scan
    for command in (twist(0.03), twist(0.0, 0.03), twist(turn=0.05), twist(-0.01)):
        guard.scanner.scan()
        guard.step(command, arm(guard), DT)
    guard.scanner.scan()
    stops(guard, backend, "blind", twist(-0.03))
