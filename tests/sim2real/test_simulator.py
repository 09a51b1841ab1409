import signal
from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest

from kinfeas.config import PluginSpec
from kinfeas.config.recipes import ENGINES, default_engine
from kinfeas.core.backend import SCAN_RANGE
from kinfeas.core.spatial import yaw
from kinfeas.robots.loading import load_robot
from kinfeas.sim2real.link import JointPath
from kinfeas.sim2real.simulator import (
    JointSetpoints,
    SimulatedRobot,
    simulate,
    spawn,
    world_of,
)
from kinfeas.tasks.loading import load_task

TICK = 0.01


def path(joints, *points):
    """Return a trajectory of (time, positions)."""
    times, positions = zip(*points, strict=True)
    return JointPath(joints, np.array(times), np.array(positions, dtype=float))


def test_setpoints_pass_the_points_in_order_and_hold_the_last():
    setpoints = JointSetpoints({"a": 0.0, "b": 4.0, "c": 7.0})
    setpoints.follow(path(("b", "a", "unknown"), (1.0, [4, 1, 9]), (3.0, [0, -1, 9])), 10.0)
    for time, a, b in ((10.0, 0.0, 4.0), (11.0, 1.0, 4.0), (13.0, -1.0, 0.0), (99.0, -1.0, 0.0)):
        assert setpoints.at(time) == pytest.approx({"a": a, "b": b, "c": 7.0})


@pytest.mark.parametrize("start", [0.0, 2e7])  # seconds: 2e7 after 231 days of uptime
@pytest.mark.parametrize("points", [
    [(-1.0, [3]), (0.0, [1])], [(-2.0, [3]), (-1.0, [1])], [(0.0, [3]), (1.0, [1])],
])  # fmt: skip
def test_setpoints_leave_out_points_of_the_past(start, points):
    setpoints = JointSetpoints({"a": 0.0})
    setpoints.follow(path(("a",), *points), start)
    assert setpoints.at(start)["a"] == 0.0
    assert 0.0 < setpoints.at(start + 0.9)["a"] <= 1.0
    assert setpoints.at(start + 1.0)["a"] == pytest.approx(1.0)


def test_setpoints_do_not_overshoot_points_at_uneven_times():
    setpoints = JointSetpoints({"a": 0.0})
    setpoints.follow(path(("a",), (0.001, [0.02]), (1.0, [0.1]), (1.01, [0.1])), 0.0)
    for time in np.linspace(0.0, 1.1, 50):
        assert -1e-9 <= setpoints.at(time)["a"] <= 0.1 + 1e-9


def test_setpoints_go_on_at_their_velocity_and_come_to_rest():
    setpoints = JointSetpoints({"a": 0.0})
    setpoints.follow(path(("a",), (2.0, [3])), 10.0)
    assert setpoints.at(11.0)["a"] == pytest.approx(1.5)  # at 1.5 times the mean velocity
    setpoints.follow(path(("a",), (1.0, [3])), 11.0)
    for time, velocity in ((11.0, 2.25), (12.0, 0.0)):
        moved = setpoints.at(time + 1e-4)["a"] - setpoints.at(time)["a"]
        assert moved / 1e-4 == pytest.approx(velocity, abs=1e-2)


@pytest.fixture(scope="module", params=ENGINES)
def world(request):
    pytest.importorskip(request.param)
    backend, state = spawn(load_robot("hsr"), engine=request.param)
    yield backend, state
    backend.close()


@pytest.fixture
def player(world, time):
    """A robot at home, at the origin."""
    backend, state = world
    backend.reset(state.base_pose, state.joint_positions)
    return SimulatedRobot(backend, state, 5.0, time.clock)


def advance(player, time, steps):
    for _ in range(steps):
        player.step(TICK)
        time.passes(TICK)


def test_drives_in_the_base_frame_until_commands_cease(player, time):
    for velocity, steps in (([0.0, 0.0, 0.4], 200), ([0.2, 0.0, 0.0], 60)):
        player.orders().drive(np.array(velocity))
        advance(player, time, steps)
    base, _ = player.measure()
    assert base.yaw == pytest.approx(0.8, abs=0.15)
    assert np.arctan2(base.y, base.x) == pytest.approx(base.yaw, abs=0.1)
    np.testing.assert_allclose(base.velocity, [0.2, 0.0, 0.0], atol=0.02)
    time.passes(5.0)
    advance(player, time, 40)
    assert player.timeouts == 1
    np.testing.assert_allclose(player.measure()[0].velocity, 0.0, atol=0.005)


def test_joints_and_grippers_follow_their_commands_and_are_reported_by_name(player, time):
    robot = load_robot("hsr")
    name, home = robot.arm[-1].name, robot.home["home"]
    _, before = player.measure()
    assert before.positions[name] == pytest.approx(home[-1], abs=1e-6)
    assert set(robot.fixed_joints) <= set(before.positions)
    assert not any(joint.startswith("planar") for joint in before.positions)
    goal = home[-1] + 0.3
    player.orders().move(path((name,), (0.01, [goal])))
    openings = []
    for grip in ("open", "close"):
        player.orders().grip(grip)
        advance(player, time, 150)
        openings.append(player.measure()[1].positions[robot.gripper.fingers[0]])
    _, after = player.measure()
    assert after.positions[name] == pytest.approx(goal, abs=0.02)
    assert after.positions[robot.arm[0].name] == pytest.approx(home[0], abs=0.02)
    assert openings[0] == pytest.approx(robot.gripper.open, rel=0.1)
    assert openings[1] < 0.5 * openings[0]


def test_runs_in_real_time(world, time):
    link, ready, start = Mock(), Mock(), time.monotonic
    robot = SimulatedRobot(*world, clock=time.clock)
    robot.orders().move(path(("nose",), (0.01, [1.0])))
    robot.orders().drop()
    result = simulate(robot, link, ready, 50.0, 0.5)
    assert time.monotonic - start == pytest.approx(0.5, abs=0.03)
    assert result.seconds == pytest.approx(0.5, abs=0.03)
    assert (result.joint_commands, result.dropped) == (1, 2)
    ready.assert_called_once()
    link.close.assert_called_once()
    assert link.report.call_count == pytest.approx(25, abs=2)
    stamps = [call.args[0].stamp for call in link.report.call_args_list]
    assert stamps == sorted(stamps)
    scans = sum(call.args[2] is not None for call in link.report.call_args_list)
    assert scans == pytest.approx(5, abs=1)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_end_it_with_its_result_also_where_they_are_ignored(world, time, number):
    before = signal.signal(number, signal.SIG_IGN)
    link = Mock(report=lambda *_: signal.raise_signal(number))
    result = simulate(SimulatedRobot(*world, clock=time.clock), link, Mock(), 50.0)
    assert signal.signal(number, before) is signal.SIG_IGN
    assert result.seconds < 0.1
    link.close.assert_called_once()


def test_time_passes_as_fast_for_a_robot_whose_periods_end_late(world, time):
    """Commands act on what comes after them: none has come before the first second."""
    late = iter([0.0, 0.007] * 200)

    def sleep(seconds):
        time.passes(seconds + next(late))

    backend, state = world
    backend.reset(state.base_pose, state.joint_positions)
    robot, ways = SimulatedRobot(backend, state, 5.0, replace(time.clock, sleep=sleep)), []

    def report(base, joints, ranges):
        ways.append((time.monotonic - start, base.x))
        if ways[-1][0] >= 1.0:
            robot.orders().drive(np.array([0.2, 0.0, 0.0]))

    start = time.monotonic
    simulate(robot, Mock(report=report), Mock(), 100.0, 3.0)
    seconds, x = np.array(ways).T
    first = np.argmax(seconds >= 1.0)
    np.testing.assert_allclose(x[: first + 1], 0.0, atol=1e-4)
    moving = seconds > 1.5
    assert np.polyfit(seconds[moving], x[moving], 1)[0] == pytest.approx(0.2, rel=0.02)


def test_scans_keep_their_rate_where_periods_end_late(world, time):
    sleep, link = (lambda seconds: time.passes(seconds + 0.07)), Mock()
    robot = SimulatedRobot(*world, clock=replace(time.clock, sleep=sleep))
    simulate(robot, link, Mock(), 100.0, 2.0)
    scans = sum(call.args[2] is not None for call in link.report.call_args_list)
    assert link.report.call_count < 40
    assert scans == pytest.approx(20, abs=3)


@pytest.mark.parametrize("around", [{"task": load_task("ggr_obstacles", {})}, {"scene": "room"}])
def test_solids_of_the_task_and_furniture_are_in_its_scan(time, around):
    backend, state = spawn(load_robot("hsr"), **around)
    robot = SimulatedRobot(backend, state, clock=time.clock)
    assert np.any(robot.scan() < SCAN_RANGE)
    backend.close()


def test_commands_and_measurements_are_late_and_stamped_as_such(time):
    pytest.importorskip(default_engine())
    adapters = [
        PluginSpec("command_latency", {"seconds": 0.1}),
        PluginSpec("sensor_latency", {"seconds": 0.05}),
    ]
    backend, state = spawn(load_robot("hsr"), adapters=adapters)
    robot, world = SimulatedRobot(backend, state, 5.0, time.clock), world_of(backend)
    robot.orders().drive(np.array([0.0, 0.0, 0.5]))
    headings, shown, stamps = [], [], []
    for _ in range(50):
        advance(robot, time, 1)
        base, _ = robot.measure()
        headings.append(float(yaw(world._measure(np.array([0])).base_pose)[0]))
        shown.append(base.yaw)
        stamps.append(time.wall - base.stamp)
    assert max(headings[:9]) < 1e-3 < headings[20]
    assert stamps[20:] == pytest.approx([0.05] * 30, abs=1e-6)
    np.testing.assert_allclose(shown[20:], headings[15:45], atol=1e-6)
    backend.close()
