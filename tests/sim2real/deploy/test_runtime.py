import math
import os
import signal
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import chain, repeat
from types import SimpleNamespace
from unittest.mock import MagicMock, Mock

import numpy as np
import pytest

from kinfeas.backends.analytic import AnalyticBackend
from kinfeas.config import PluginSpec
from kinfeas.control.loop import Loop
from kinfeas.core import spatial
from kinfeas.core.backend import RealTimeBackend, StopCall
from kinfeas.core.errors import KinfeasError
from kinfeas.envs.world import World
from kinfeas.evaluation.evaluate import configure
from kinfeas.io.run_log import REACHED, About, Recorder, read_record
from kinfeas.kinematics.ik import IkSolver
from kinfeas.policies.loading import load_policy
from kinfeas.robots.loading import load_robot
from kinfeas.sim2real.deploy import runtime
from kinfeas.sim2real.deploy.config import DeployConfig, Guards
from kinfeas.sim2real.deploy.runtime import Code, Setup, Signals, deploy
from kinfeas.sim2real.deploy.start import make_goal_task, warm_up
from kinfeas.sim2real.link.rate import Rate
from kinfeas.tasks.task import MotionSpec
from kinfeas.viz.replay import as_recording, record_episodes

DT = 0.02
QUICK = MotionSpec("linear", {"gain": 1.0})
PR2 = IkSolver(load_robot("pr2"))


class RealTimeRobot(AnalyticBackend, RealTimeBackend):
    """A robot in real time by simulated clocks; after some steps `trouble` returns its state."""

    def __init__(self, time, trouble=None, after=10):
        super().__init__()
        super().reset(spatial.IDENTITY[np.newaxis], PR2.robot.home["home"][np.newaxis])
        self.time, self.rate = time, Rate(DT, time.clock)
        self.trouble, self.after = trouble, after if trouble else math.inf
        self.measured, self.commands, self.close = time.monotonic, [], Mock()

    def reset(self, base_pose, joint_positions, env_ids=None):
        return self.read()

    def step(self, base_twist, joint_targets, dt):
        self.commands.append((self.time.monotonic, base_twist.copy()))
        super().step(base_twist, joint_targets, dt)
        self.rate.wait()
        return self.read()

    def read(self):
        broken = len(self.commands) > self.after
        if not broken:
            self.measured = self.time.monotonic
        state = replace(self.state, age=np.array([self.time.monotonic - self.measured]))
        return self.trouble(state) if broken else state

    def stop(self):
        self.commands.append((self.time.monotonic, np.zeros((1, 6))))


def silence(state):
    return state


def far(state):
    return replace(state, base_pose=state.base_pose + 9.0 * np.eye(7)[0])


def nan(state):
    return replace(state, base_pose=state.base_pose * np.nan)


NOTHING = Mock(return_value=None)


class Drive:
    """A policy of full speed ahead, which does something at one of its steps."""

    def __init__(self, at=10**9, do=lambda: None, action=(1.0, 0.0, 0.0)):
        self.at, self.do, self.action, self.steps = at, do, np.array([action]), 0

    def act(self, policy_input):
        self.steps += 1
        if self.steps == self.at:
            self.do()
        return self.action


@pytest.fixture(scope="module", autouse=True)
def compiled():
    filters = PluginSpec("obstacle_distance"), PluginSpec("feasibility")
    warm_up(PR2, Drive(), goal(1.0, 0.0, 0.8), DT, filters=filters)


def goal(*position):
    return make_goal_task(position, None, QUICK)


@pytest.fixture
def run(tmp_path, time):
    def start(backend, driver, task=None, guards=None, filters=(), **changes):
        config = DeployConfig(guards=guards or Guards(), filters=filters)
        settings = {"dt": DT, "seconds": 2.0, "clock": time.clock, "config": config, **changes}
        setup = Setup(PR2, driver, task or goal(3.0, 0.0, 0.8), backend, **settings)
        joints = tuple(joint.name for joint in PR2.robot.arm)
        about = About("pr2", setup.task.name, "?", "?", DT, joints, "now")
        path = tmp_path / "run.csv"
        path.unlink(missing_ok=True)
        with Recorder(path, about) as recorder:
            outcome = deploy(setup, recorder)
        return outcome, read_record(path)

    return start


@pytest.mark.parametrize(("done", "code", "end"), [
    (True, Code.REACHED, ", task done"), (False, Code.TIME_OVER, ", task not done"),
])  # fmt: skip
def test_reaches_the_goal_and_reports_task_success(run, done, code, end):
    target = goal(0.9, 0.1, 0.8)
    parts = {"name": target.name, "subgoals": target.subgoals, "sample": target.sample}
    measured = Mock(return_value=done)
    task = SimpleNamespace(**parts, sample_in=Mock(), drawn=Mock(), task_done=measured)
    trained = load_policy("pretrained", PR2.robot)
    outcome, record = run(AnalyticBackend(), trained, task, seconds=100.0, real_time=False)
    assert (outcome.code, outcome.reason) == (code, REACHED + end)
    assert outcome.task_done is done and measured.call_args.kwargs == {"reached": True}
    assert (record.event[0], record.event[-1]) == ("start", REACHED + end)
    assert not record.base_twist[-1].any()
    assert record.base_twist.any()
    assert record.time[-1] == pytest.approx(outcome.seconds)
    np.testing.assert_allclose(record.goal[:, :3], np.tile(target.goal, (len(record.goal), 1)))


class Bold:
    """A policy whose actions exceed their range, and which observes the last ones."""

    def __init__(self, network):
        self.network = network
        self.observation_terms = (*network.observation_terms, "previous_command")

    def act(self, policy_input):
        size = self.network.biases[-1].size
        observation, previous = np.split(policy_input.values, [-size], axis=1)
        return 3.0 * self.network(observation) + 0.1 * previous


@pytest.mark.parametrize(("name", "filters", "drive"), [
    *((name, ["feasibility"], lambda network: network) for name in ("pr2", "tiago", "hsr")),
    ("hsr", [], Bold),
])  # fmt: skip
def test_a_run_has_the_poses_of_an_evaluation_to_the_bit(name, filters, drive):
    robot, moments = load_robot(name), []
    driver = drive(load_policy("pretrained", robot))
    # Accelerations that the policy does not reach, since evaluations have no limits.
    base = replace(robot.base, max_acceleration=99.0, max_rotation_acceleration=99.0)
    settings = {"task.distance": [1.0, 1.2], "world.filters": filters}
    config = configure(replace(robot, base=base), "ggr", seed=3, settings=settings)
    world = World(config.robot, config.task, config.world, config.seed)
    (recording,) = record_episodes(world, driver, 1)
    setup = Setup(
        world.solver, driver, config.task, AnalyticBackend(robot), config.world.dt,
        real_time=False, seed=3, config=DeployConfig(filters=config.world.filters),
    )  # fmt: skip
    assert deploy(setup, Mock(write=moments.append)).code == Code.REACHED
    moments = moments[: len(recording.base_pose)]  # the last one is the stop
    for key in ("base_pose", "joint_positions", "desired"):
        values = np.array([getattr(moment, key) for moment in moments])
        np.testing.assert_array_equal(values, getattr(recording, key), err_msg=key)


def test_a_run_in_real_time_keeps_its_rate_and_ends_in_time(run, time, caplog):
    robot = RealTimeRobot(time)
    outcome, record = run(robot, Drive(), seconds=0.4)
    assert outcome.code is Code.TIME_OVER
    assert outcome.timing.p50 == pytest.approx(DT)
    speeds = np.array([twist[0, 0] for _, twist in robot.commands])
    limit = PR2.robot.base.max_acceleration
    assert outcome.seconds == pytest.approx(0.4 + speeds.max() / limit, abs=1.5 * DT)
    assert np.abs(np.diff(speeds)).max() <= limit * DT + 1e-9
    # The first period is over at once: it starts the clock of the robot.
    assert len(record.time) == 21 + 5 + 2
    assert robot.close.called
    assert "too long" not in caplog.text
    # The same with a policy that misses four deadlines of five.
    slow = Drive()
    act, slow.act = slow.act, lambda observation: (time.passes(5 * DT), act(observation))[1]
    outcome, record = run(RealTimeRobot(time), slow, seconds=0.5)
    assert outcome.code is Code.TIME_OVER
    assert outcome.seconds == pytest.approx(0.6, abs=0.1)
    assert "too long" in caplog.text


@pytest.mark.parametrize("real", [False, True])
def test_a_long_start_does_not_age_the_first_command(run, time, monkeypatch, real):
    start = Loop.start
    monkeypatch.setattr(Loop, "start", lambda *arguments: (start(*arguments), time.passes(5.0)))
    backend = RealTimeRobot(time) if real else AnalyticBackend()
    outcome, record = run(backend, Drive(), seconds=0.4)
    assert (outcome.code, outcome.timing.misses) == (Code.TIME_OVER, 0)
    assert record.time[-1] == pytest.approx(0.5, abs=0.03)  # it brakes


def test_a_simulated_world_waits_for_the_clock_or_has_none(run, time):
    start = time.monotonic
    outcome, _ = run(AnalyticBackend(), Drive(), seconds=0.4)
    assert outcome.code is Code.TIME_OVER
    assert time.monotonic - start == pytest.approx(0.5, abs=DT)  # it brakes
    stall = Drive(at=3, do=lambda: time.passes(0.3))
    assert run(AnalyticBackend(), stall)[0].code is Code.FAULT
    stall = Drive(at=3, do=lambda: time.passes(0.3))
    assert run(AnalyticBackend(), stall, seconds=0.2, real_time=False)[0].code is Code.TIME_OVER


@pytest.mark.parametrize(("trouble", "reason"), [
    (silence, "measurement"),
    (far, "jumped"),
    (nan, "base_pose is not finite"),
    (NOTHING, "RobotState"),
    (Mock(side_effect=ConnectionError("the bus is gone")), "the bus is gone"),
    (Mock(side_effect=KeyError("boom")), "backend RealTimeRobot raised KeyError: 'boom'"),
    (Mock(side_effect=SystemExit(5)), "backend RealTimeRobot raised SystemExit: 5"),
])  # fmt: skip
def test_a_robot_in_trouble_is_stopped_in_time(run, time, caplog, trouble, reason):
    robot = RealTimeRobot(time, trouble)
    outcome, record = run(robot, Drive())
    assert outcome.code is Code.FAULT
    assert reason in outcome.reason
    moving = [at for at, twist in robot.commands if twist.any()]
    stopped = next(at for at, _ in robot.commands[len(moving) :])
    assert stopped - robot.commands[robot.after][0] < 0.3
    assert not any(twist.any() for _, twist in robot.commands[len(moving) :])
    assert record.event[-1] == outcome.reason
    # The last line is the control period that was measured, or else the stop.
    measured = trouble in (silence, far, nan, NOTHING)
    assert record.base_twist[-1].any() == measured
    assert np.isnan(record.base_pose[-1]).all() == (trouble in (nan, NOTHING))
    assert (record.base_pose[-1, 0] > 9.0) == (trouble is far)
    assert (record.age[-1] > Guards().max_age) == (trouble is silence)
    assert len(record.time) == len(moving) + 1
    assert np.isfinite(record.base_pose[record.later]).all()
    assert np.isfinite(as_recording(record, PR2.robot).ee_pose).all()
    # A mistake in the code of a plugin needs its traceback.
    assert ("Traceback" in caplog.text) is ("raised" in reason)


@pytest.mark.parametrize(("driver", "named", "filters"), [
    (Drive(action=(np.nan, 0.0, 0.0)), "not finite", ()),
    (Drive(action=(0.0, 0.0)), "shape", (PluginSpec("feasibility"),)),
    (Drive(at=5, do=lambda: 1 / 0), "policy Drive raised ZeroDivisionError", ()),
    (Drive(at=5, do=lambda: sys.exit(0)), "policy Drive raised SystemExit",
     (PluginSpec("feasibility"),)),
    (Drive(), "command filter Mock", (Mock(side_effect=SystemExit, spec=["__call__"]),)),
])  # fmt: skip
def test_a_policy_or_filter_that_fails_stops_the_robot(run, time, driver, named, filters):
    robot = RealTimeRobot(time)
    robot.close.side_effect = RuntimeError("boom")
    outcome, record = run(robot, driver, filters=filters)
    assert outcome.code is Code.FAULT
    assert named in outcome.reason
    assert record.event[-1] == outcome.reason
    assert not robot.commands[-1][1].any()
    assert (outcome.unstopped, outcome.unclosed) == ("", "boom")


@pytest.mark.parametrize("lost", [False, True])
def test_a_watchdog_that_is_lost_ends_a_run_and_one_takes_over_where_stopping_fails(
    run, time, monkeypatch, lost
):
    dog = MagicMock()
    dog.__enter__.return_value, dog.__exit__.return_value = dog, None
    dog.beat.side_effect = chain(repeat("", 10), repeat("lost" if lost else ""))
    watchdog = Mock(return_value=dog)
    monkeypatch.setattr(runtime, "Watchdog", watchdog)
    robot = RealTimeRobot(time)
    robot.stop_call = lambda: StopCall("nowhere:stop")
    if not lost:
        robot.stop = Mock(side_effect=ConnectionError("gone"))
    outcome, _ = run(robot, Drive())
    watchdog.assert_called_once_with(robot.stop_call(), Guards().watchdog)
    assert outcome.code is (Code.FAULT if lost else Code.TIME_OVER)
    assert (dog.abandon.called, outcome.unstopped) == (not lost, "" if lost else "gone")
    assert outcome.timing.periods == pytest.approx(9 if lost else 105, abs=2)


@pytest.mark.parametrize("trouble", [nan, NOTHING, Mock(side_effect=KeyError("boom"))])
def test_a_run_that_cannot_start_is_an_error_and_moves_nothing(run, time, trouble):
    robot = RealTimeRobot(time, trouble, after=-1)
    with pytest.raises((KinfeasError, KeyError)):
        run(robot, Drive())
    assert robot.close.called
    assert not any(twist.any() for _, twist in robot.commands)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT])
def test_signals_end_a_run_cleanly(run, time, number):
    before = signal.getsignal(number)
    robot = RealTimeRobot(time)
    outcome, record = run(robot, Drive(at=5, do=lambda: os.kill(os.getpid(), number)))
    assert outcome.code == 128 + number
    assert not robot.commands[-1][1].any()
    assert record.event[-1] == outcome.reason
    assert signal.getsignal(number) is before


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, None), (signal.SIGTERM, 143)])
def test_signals_end_the_wait_for_a_robot_at_once(run, time, number, code):
    robot = RealTimeRobot(time)
    robot.reset = lambda *_: os.kill(os.getpid(), number)
    with pytest.raises(KeyboardInterrupt if code is None else SystemExit) as end:
        run(robot, Drive())
    assert getattr(end.value, "code", None) == code
    assert robot.close.called


def test_a_run_in_a_thread_and_after_a_handled_error_has_its_own_end(run, time):
    def start():
        try:
            raise ValueError("earlier")
        except ValueError:
            return run(RealTimeRobot(time), Drive(), seconds=0.2)

    with ThreadPoolExecutor(1) as pool:
        outcome, record = pool.submit(start).result()
    assert outcome.code is Code.TIME_OVER
    assert record.event[-1] == outcome.reason


def test_a_second_signal_does_not_wait_for_the_loop_and_nohup_outlives_its_terminal():
    with Signals() as signals:
        signals.noting = True
        for _ in range(2):  # a terminal may send it twice
            os.kill(os.getpid(), signal.SIGHUP)
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)
    assert signals.caught is signal.SIGHUP
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    with Signals() as signals:
        signals.noting = True
        os.kill(os.getpid(), signal.SIGHUP)
    signal.signal(signal.SIGHUP, before)
    assert signals.caught is None
