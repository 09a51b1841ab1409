import os
import re
import signal
import sys
import threading
import time
from dataclasses import replace

import numpy as np
import pytest

from kinfeas.backends.analytic import AnalyticBackend
from kinfeas.core import spatial
from kinfeas.core.backend import RobotState
from kinfeas.core.errors import KinfeasError
from kinfeas.io.run_log import REACHED, About, Recorder, read_record
from kinfeas.kinematics.ik import IkSolver
from kinfeas.policies import network as policy
from kinfeas.policies import pretrained
from kinfeas.robots.loading import load_robot
from kinfeas.sim2real.deploy.goal_task import make_goal_task
from kinfeas.sim2real.deploy.guard_config import Guards
from kinfeas.sim2real.deploy.guards import Clocks
from kinfeas.sim2real.deploy.rate import Rate
from kinfeas.sim2real.deploy.rollout_planner_thread import RolloutPlannerThread
from kinfeas.sim2real.deploy.runtime import Code, Setup, deploy
from kinfeas.sim2real.deploy.warm_up import warm_up
from kinfeas.sim2real.deploy.watchdog import StopCall, Watchdog
from kinfeas.tasks.chain import read_chain
from kinfeas.tasks.task import MotionSpec

DT = 0.02
QUICK = MotionSpec("linear", {"gain": 1.0})
STAND_IN = """
import time


def connect(path):
    def stop():
        with open(path, "a") as file:
            file.write(f"{time.monotonic()}\\n")

    return stop
"""


class RealTimeRobot:
    """A robot with a clock of its own, in this process; a test may break it after some steps."""

    def __init__(self, robot, trouble=None, after=10):
        self.world, self.robot = AnalyticBackend(), robot
        self.world.reset(spatial.IDENTITY[np.newaxis], robot.home["home"][np.newaxis])
        self.rate = Rate(DT)
        self.trouble, self.after = trouble, after
        self.measured, self.commands, self.closed = time.monotonic(), [], 0

    @property
    def broken(self):
        return len(self.commands) > self.after

    def reset(self, base_pose, joint_positions, env_ids=None):
        return self.read()

    def step(self, base_twist, joint_targets, dt):
        self.commands.append((time.monotonic(), base_twist.copy()))
        self.world.step(base_twist, joint_targets, dt)
        self.rate.wait()
        if self.broken and self.trouble in {KeyError, ConnectionError}:
            raise self.trouble("the bus is gone")
        return self.read()

    def read(self):
        state, now = self.world.state, time.monotonic()
        if not (self.broken and self.trouble == "silence"):
            self.measured = now
        if self.broken and self.trouble == "nan":
            state = RobotState(state.base_pose * np.nan, state.joint_positions)
        return replace(state, age=np.array([now - self.measured]))

    def stop(self):
        self.commands.append((time.monotonic(), np.zeros((1, 6))))

    def close(self):
        self.closed += 1

    def stopped_after(self, moment):
        """Return the seconds from a moment to the first command from which on the base stands."""
        moving = [i for i, (_, twist) in enumerate(self.commands) if twist.any()]
        return self.commands[moving[-1] + 1][0] - moment


class WatchedRobot(RealTimeRobot):
    """The same, which another process can stop."""

    path = ""

    def stop_call(self):
        return StopCall("stand_in:connect", {"path": self.path})


class Drive:
    """A policy of full speed ahead, which does something else at one of its steps."""

    def __init__(self, at=10**9, do=lambda: None, action=(1.0, 0.0, 0.0)):
        self.at, self.do, self.action, self.steps = at, do, np.array([action]), 0

    def act(self, policy_input):
        self.steps += 1
        if self.steps == self.at:
            self.do()
        return self.action


class SlowDrive(Drive):
    """The same, at a fifth of the rate."""

    def act(self, policy_input):
        time.sleep(5 * DT)
        return super().act(policy_input)


@pytest.fixture(scope="module")
def pr2():
    return IkSolver(load_robot("pr2"))


@pytest.fixture(scope="module")
def trained(pr2):
    return policy.read_network(pretrained.find("pr2"), pr2.robot)


def goal(*position):
    return make_goal_task(position, None, QUICK)


@pytest.fixture
def run(tmp_path, pr2):
    """Return a function that runs and returns outcome and record."""
    warm_up(pr2, Drive(), goal(1.0, 0.0, 0.8), DT)

    def start(backend, driver, task=None, **changes):
        settings = {"dt": DT, "seconds": 2.0, **changes}
        setup = Setup(pr2, driver, task or goal(3.0, 0.0, 0.8), backend, **settings)
        joints = tuple(joint.name for joint in pr2.robot.arm)
        about = About("pr2", setup.task.name, "?", "?", DT, joints, "now")
        with Recorder(tmp_path / "run.csv", about) as recorder:
            outcome = deploy(setup, recorder)
        return outcome, read_record(tmp_path / "run.csv")

    return start


class WithObjects:
    """A task that tells what became of its objects."""

    def __init__(self, task, done):
        self.task, self.name, self.subgoals, self.sample = (
            task,
            task.name,
            task.subgoals,
            task.sample,
        )
        self.done, self.settle, self.drawn = lambda: done, lambda joints, dt: None, dict


@pytest.mark.parametrize(("done", "end"), [(True, "done"), (False, "not done"), (None, None)])
def test_tells_whether_the_task_was_done(run, trained, done, end):
    task = WithObjects(goal(0.9, 0.1, 0.8), done)
    outcome, record = run(AnalyticBackend(), trained, task, seconds=100.0, real_time=False)
    assert outcome.task_done is done
    assert outcome.reason == REACHED
    assert record.event[-1] == (REACHED if end is None else f"{REACHED}, task {end}")


def test_drives_to_the_goal_and_stops_there(run, trained):
    outcome, record = run(
        AnalyticBackend(), trained, goal(0.9, 0.1, 0.8), seconds=100.0, real_time=False
    )
    assert (outcome.code, outcome.reason) == (Code.REACHED, REACHED)
    assert record.event[0] == "start"
    assert record.event[-1] == REACHED
    assert not record.base_twist[-1].any()
    assert record.base_twist.any()
    assert record.time[-1] == pytest.approx(outcome.seconds)
    np.testing.assert_allclose(record.goal[:, :3], np.tile([0.9, 0.1, 0.8], (len(record.goal), 1)))


def test_equal_seeds_make_equal_runs(run, trained, tmp_path):
    texts = []
    for _ in range(2):
        run(AnalyticBackend(), trained, seconds=0.5, real_time=False, seed=3)
        texts.append((tmp_path / "run.csv").read_text())
        (tmp_path / "run.csv").unlink()
    assert texts[0] == texts[1]


def test_goes_through_a_chain_of_sub_goals(run, trained, tmp_path):
    (tmp_path / "two.yaml").write_text(
        "{name: two, start: {square: 0.0, heading: 0.0}, places: {a: {position: [0.9, 0, 0.8]}, "
        "b: {position: [0.9, 0.1, 0.8]}}, "
        "subgoals: [{place: a, dwell: 0.1, motion: {parameters: {gain: 1}}}, "
        "{place: b, motion: {parameters: {gain: 1}}}]}"
    )
    task = read_chain(tmp_path / "two.yaml")
    outcome, record = run(AnalyticBackend(), trained, task, seconds=200.0, real_time=False)
    assert outcome.code is Code.REACHED
    change = record.event.index("sub-goal 2 begins")
    assert record.subgoal[change] == 0
    assert record.subgoal[change + 1] == 1
    np.testing.assert_allclose(record.goal[change, :3], [0.9, 0.0, 0.8])
    np.testing.assert_allclose(record.goal[change + 1, :3], [0.9, 0.1, 0.8])


def test_time_that_is_over_ends_a_run_that_kept_its_rate(run):
    robot = RealTimeRobot(load_robot("pr2"))
    outcome, record = run(robot, Drive(), seconds=0.4)
    assert outcome.code is Code.TIME_OVER
    assert outcome.timing.p50 == pytest.approx(DT, abs=0.01)
    assert outcome.seconds == pytest.approx(0.4, abs=0.5 * DT)
    # The first period is over at once: it sets the clock going.
    assert len(record.time) == 21 + 2
    assert robot.closed


@pytest.mark.parametrize(("trouble", "reason"), [
    # Which of the two guards of its age comes first is a matter of microseconds.
    ("silence", r"(the newest measurement is|the command is made of a measurement) 0\.2"),
    ("nan", "the measured base pose is not finite"),
    (ConnectionError, "the bus is gone"),
])  # fmt: skip
def test_a_robot_in_trouble_is_stopped_in_time(run, trouble, reason):
    robot = RealTimeRobot(load_robot("pr2"), trouble)
    outcome, record = run(robot, Drive())
    assert outcome.code is Code.FAULT
    assert re.match(reason, outcome.reason)
    assert robot.stopped_after(robot.commands[robot.after][0]) < 0.3
    assert record.event[-1] == outcome.reason
    assert not record.base_twist[-1].any()


def test_a_bug_stops_the_base_before_anybody_hears_of_it(run, capsys):
    robot = RealTimeRobot(load_robot("pr2"), KeyError)
    outcome, record = run(robot, Drive())
    assert (outcome.code, outcome.reason) == (Code.FAULT, "KeyError: 'the bus is gone'")
    assert robot.stopped_after(robot.commands[robot.after][0]) < 0.3
    assert record.event[-1] == outcome.reason
    assert 'raise self.trouble("the bus is gone")' in capsys.readouterr().err


def test_time_is_over_by_the_clock_even_if_periods_are_missed(run):
    robot = RealTimeRobot(load_robot("pr2"))
    began = time.monotonic()
    outcome, _ = run(robot, SlowDrive(), seconds=0.5)
    assert outcome.code is Code.TIME_OVER
    assert outcome.seconds == pytest.approx(0.5, abs=0.1)
    assert time.monotonic() - began < 5.0


def test_a_stall_is_ended_by_the_watchdog_and_then_by_the_guards(run, tmp_path, monkeypatch):
    (tmp_path / "stand_in.py").write_text(STAND_IN)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    robot = WatchedRobot(load_robot("pr2"))
    robot.path = str(tmp_path / "stops")
    outcome, record = run(robot, Drive(at=10, do=lambda: time.sleep(0.5)))
    assert outcome.code is Code.FAULT
    assert outcome.reason.startswith("the command is made of a measurement 0.5")
    first = float((tmp_path / "stops").read_text().split()[0])
    last_command = [at for at, twist in robot.commands if twist.any()][-1]
    assert first - last_command < 0.3
    assert record.event[-1] == outcome.reason


def test_a_watchdog_that_stalls_ends_the_run(run, tmp_path, monkeypatch):
    (tmp_path / "stand_in.py").write_text(STAND_IN)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    robot, stalled = WatchedRobot(load_robot("pr2")), []
    robot.path = str(tmp_path / "stops")
    begin = Watchdog.__enter__

    def stall():
        stalled.append(time.monotonic())
        os.kill(watchdogs[0]._process.pid, signal.SIGSTOP)

    watchdogs = []
    monkeypatch.setattr(Watchdog, "__enter__", lambda one: watchdogs.append(one) or begin(one))
    outcome, _ = run(robot, Drive(at=10, do=stall))
    assert (outcome.code, outcome.reason) == (
        Code.FAULT,
        "the watchdog has stopped the base, or has died or stalled",
    )
    last_command = [at for at, twist in robot.commands if twist.any()][-1]
    assert last_command - stalled[0] < 0.3
    assert robot.stopped_after(last_command) < 0.2
    assert watchdogs[0]._process.returncode is not None


def test_looking_ahead_ends_with_the_run(run, trained):
    before = sys.getswitchinterval()
    run(AnalyticBackend(), RolloutPlannerThread(trained), seconds=0.2, real_time=False)
    assert sys.getswitchinterval() == before
    assert not any(thread.name.startswith("rollout_planner") for thread in threading.enumerate())


@pytest.mark.parametrize(("guards", "warns"), [
    (Guards(), True),
    (Guards(watchdog=None), False),  # as the user wants it
])  # fmt: skip
def test_a_robot_without_a_watchdog_is_said_to_have_none(run, capsys, guards, warns):
    run(RealTimeRobot(load_robot("pr2")), Drive(), seconds=0.1, guards=guards)
    line = "no watchdog: nothing stops the base if this process dies or hangs, for "
    line += "RealTimeRobot has no"
    assert capsys.readouterr().err == (f"{line} stop_call\n" if warns else "")


def test_a_simulated_world_ends_with_its_process_and_needs_no_watchdog(run, capsys):
    run(AnalyticBackend(), Drive(), seconds=0.1, real_time=False)
    assert capsys.readouterr().err == ""


def test_a_clock_that_is_set_stops_the_base(run):
    ahead = [0.0]
    clocks = Clocks(time.monotonic, lambda: time.time() + ahead[0])
    robot = RealTimeRobot(load_robot("pr2"))
    driver = Drive(at=10, do=lambda: ahead.__setitem__(0, 60.0))
    outcome, _ = run(robot, driver, clocks=clocks)
    assert (outcome.code, outcome.reason) == (Code.FAULT, "the system's clock was set by +60.00 s")
    assert not robot.commands[-1][1].any()


def test_a_world_without_a_clock_may_be_slow(run):
    def stall():
        time.sleep(0.3)

    driver = Drive(at=3, do=stall)
    outcome, _ = run(AnalyticBackend(), driver, seconds=0.2, real_time=False)
    assert outcome.code is Code.TIME_OVER


@pytest.mark.parametrize(("number", "code"), [
    (signal.SIGINT, Code.INTERRUPTED),
    (signal.SIGTERM, Code.TERMINATED),
    (signal.SIGHUP, Code.HUNG_UP),
    (signal.SIGQUIT, Code.QUIT),
])  # fmt: skip
def test_signals_end_a_run_cleanly(run, number, code):
    before = signal.getsignal(number)
    robot = RealTimeRobot(load_robot("pr2"))
    outcome, record = run(robot, Drive(at=5, do=lambda: os.kill(os.getpid(), number)))
    assert outcome.code is code
    assert outcome.code == 128 + number
    assert not robot.commands[-1][1].any()
    assert record.event[-1] == outcome.reason
    assert signal.getsignal(number) is before


@pytest.mark.parametrize(("action", "reason"), [
    ((np.nan, 0.0, 0.0), "the policy's action is not finite"),
    ((0.0, 0.0), "the policy's action has the shape"),
])  # fmt: skip
def test_a_policy_that_fails_stops_the_base(run, action, reason):
    outcome, _ = run(RealTimeRobot(load_robot("pr2")), Drive(action=action))
    assert outcome.code is Code.FAULT
    assert outcome.reason.startswith(reason)


def test_an_arm_that_cannot_follow_stops_the_base(run):
    guards = Guards(max_consecutive_ik_failures=20)
    outcome, record = run(
        AnalyticBackend(), Drive(), goal(-9.0, 0.0, 0.8), seconds=60.0, real_time=False,
        guards=guards,
    )  # fmt: skip
    assert outcome.code is Code.FAULT
    assert outcome.reason.endswith(", for more than 20 steps in a row")
    assert record.event[-1] == outcome.reason


def test_a_run_that_cannot_begin_is_an_error(run):
    robot = RealTimeRobot(load_robot("pr2"), "nan", after=-1)
    with pytest.raises(KinfeasError, match="not finite"):
        run(robot, Drive())
    assert robot.closed


class Broken(AnalyticBackend):
    """A backend that breaks before anything has moved."""

    def __init__(self, method, answer=None):
        super().__init__()
        self.method, self.answer = method, answer

    def reset(self, base_pose, joint_positions, env_ids=None):
        if self.method == "reset":
            if isinstance(self.answer, BaseException):
                raise self.answer
            return self.answer
        return super().reset(base_pose, joint_positions, env_ids)

    def seed(self, seeds, env_ids):
        if self.method == "seed":
            raise self.answer


class BrokenRobot(RealTimeRobot):
    """A robot that answers what a test says where one of its methods is called."""

    def __init__(self, robot, method, answer):
        super().__init__(robot)
        self.method, self.answer = method, answer

    def reset(self, base_pose, joint_positions, env_ids=None):
        return self.says("reset", RealTimeRobot.read(self))

    def step(self, base_twist, joint_targets, dt):
        return self.says("step", super().step(base_twist, joint_targets, dt))

    def read(self):
        return self.says("read", super().read())

    def stop_call(self):
        return self.says("stop_call", StopCall("nobody:needs_it"))

    def says(self, method, sound):
        if self.method == method:
            return self.answer(sound)
        return sound


@pytest.mark.parametrize("method", ["reset", "seed"])
def test_exceptions_of_a_backend_name_it(run, method):
    with pytest.raises(RuntimeError) as caught:
        run(Broken(method, RuntimeError("boom")), Drive(), real_time=False)
    assert "raised by backend Broken" in caught.value.__notes__


def test_a_backend_that_measures_nothing_is_one_sentence(run):
    with pytest.raises(KinfeasError, match=r"^backend Broken: reset must return a RobotState"):
        run(Broken("reset"), Drive(), real_time=False)


@pytest.mark.parametrize("method", ["read", "stop_call"])
def test_exceptions_of_a_robot_name_it(run, pr2, method):
    def breaks(_):
        raise KeyError("boom")

    robot = BrokenRobot(pr2.robot, method, breaks)
    guards = Guards(watchdog=None if method == "read" else 0.5)
    with pytest.raises(KeyError) as caught:
        run(robot, Drive(), guards=guards)
    assert "raised by backend BrokenRobot" in caught.value.__notes__


@pytest.mark.parametrize(("method", "answer", "sentence"), [
    ("reset", lambda _: None, "backend BrokenRobot: reset must return a RobotState"),
    ("reset", lambda state: replace(state, joint_positions=[[0.0] * 7]), "joint_positions"),
    ("read", lambda _: None, "backend BrokenRobot: read must return a RobotState"),
    ("read", lambda state: replace(state, age="old"), "backend BrokenRobot: read: age"),
    ("read", lambda state: replace(state, base_pose=state.base_pose * np.nan),
     "the measured base pose is not finite"),
    ("stop_call", lambda _: None, "backend BrokenRobot must return a StopCall from stop_call, not"),
])  # fmt: skip
def test_a_robot_that_begins_with_nonsense_is_one_sentence(run, pr2, method, answer, sentence):
    robot = BrokenRobot(pr2.robot, method, answer)
    guards = Guards(watchdog=0.5 if method == "stop_call" else None)
    with pytest.raises(KinfeasError, match=sentence):
        run(robot, Drive(), guards=guards)
    assert robot.closed
    assert not any(twist.any() for _, twist in robot.commands)


@pytest.mark.parametrize(("answer", "sentence"), [
    (lambda _: None, "step must return a RobotState"),
    (lambda state: replace(state, age="old"),
     "step: age"),
    (lambda state: replace(state, base_pose=state.base_pose.astype(complex)),
     "step: base_pose"),
    (lambda state: replace(state, ee_in_base=np.zeros(3)),
     "step: ee_in_base"),
])  # fmt: skip
def test_a_robot_that_talks_nonsense_is_stopped_with_one_sentence(
    run, pr2, capsys, answer, sentence
):
    robot = BrokenRobot(pr2.robot, "step", answer)
    outcome, record = run(robot, Drive(), guards=Guards(watchdog=None))
    assert outcome.code == Code.FAULT
    assert outcome.reason.startswith(f"backend BrokenRobot: {sentence}")
    assert record.event[-1] == outcome.reason
    assert not robot.commands[-1][1].any()
    assert capsys.readouterr().err == ""


class OwnError(Exception):
    """What a plugin's author may think up."""


class Clinging(RealTimeRobot):
    """A robot that does not let go of its bus."""

    def __init__(self, robot, error, trouble=None):
        super().__init__(robot, trouble)
        self.error = error

    def close(self):
        super().close()
        raise self.error


@pytest.mark.parametrize("error", [OwnError("boom"), SystemExit(5), KinfeasError("still busy")])
def test_a_robot_that_does_not_let_go_is_told_beside_what_the_run_came_to(run, pr2, error):
    robot = Clinging(pr2.robot, error)
    outcome, record = run(robot, Drive(), seconds=0.1)
    assert outcome.code is Code.TIME_OVER
    assert record.event[-1] == outcome.reason
    assert not robot.commands[-1][1].any()
    assert (robot.closed, outcome.unstopped) == (1, "")
    assert outcome.unclosed == str(error)


def test_why_a_run_cannot_begin_is_not_hidden_by_a_robot_that_does_not_let_go(run, pr2):
    robot = Clinging(pr2.robot, OwnError("boom"), "nan")
    robot.after = -1
    with pytest.raises(KinfeasError, match="not finite"):
        run(robot, Drive())
    assert robot.closed


def test_an_error_of_any_class_stops_the_run_and_keeps_what_it_came_to(run, pr2, capsys):
    def breaks():
        raise OwnError("boom")

    robot = RealTimeRobot(pr2.robot)
    outcome, record = run(robot, Drive(at=5, do=breaks))
    assert (outcome.code, outcome.reason) == (Code.FAULT, "OwnError: boom")
    assert record.event[-1] == outcome.reason
    assert not robot.commands[-1][1].any()
    assert "in breaks" in capsys.readouterr().err
