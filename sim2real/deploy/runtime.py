"""A run of a policy on a robot: the control loop behind guards, recorded step by step."""

import logging
import math
import signal
import threading
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import ExitStack, closing, nullcontext, suppress
from dataclasses import dataclass, field, replace
from enum import IntEnum
from functools import cached_property
from types import FrameType
from typing import Any, Self

import numpy as np

from kinfeas.config import PluginSpec
from kinfeas.control.assemble import assemble
from kinfeas.control.observation import SCAN_TERMS
from kinfeas.control.period import CommandFilter
from kinfeas.core.backend import Backend
from kinfeas.core.errors import PLUGIN_ERRORS, Fault, KinfeasError, describe, plugin_note
from kinfeas.core.metrics import lateness
from kinfeas.core.policy import Policy
from kinfeas.core.solids import Solids
from kinfeas.core.spatial import IDENTITY, Array, distance
from kinfeas.core.start import episode_rng
from kinfeas.io.run_log import REACHED, TASK_DONE, Moment, Recorder
from kinfeas.kinematics.ik import IkSolver
from kinfeas.sim2real.deploy.config import DeployConfig, Guards
from kinfeas.sim2real.deploy.guards import Guarded
from kinfeas.sim2real.deploy.start import GoalTask, begin, preflight
from kinfeas.sim2real.deploy.watchdog import Watchdog
from kinfeas.sim2real.link.rate import Clock, Rate, Timing
from kinfeas.tasks.task import StagedTask, Task, build_subgoals, target_stream

_log = logging.getLogger(__name__)

_LATE = 0.1  # fraction of control periods that may end late without a warning
_DOUBT = 0.05  # s that the base may be later or sooner than its response model without a warning


class Code(IntEnum):
    """Exit code of a run; 2 is left for runs that do not start.

    Codes from 128 on are 128 plus the number of the signal that ended the run, as in a shell.
    """

    REACHED = 0
    FAULT = 3
    TIME_OVER = 4  # also if the goal was reached, but the task is not done
    HUNG_UP = 128 + signal.SIGHUP
    INTERRUPTED = 128 + signal.SIGINT
    QUIT = 128 + signal.SIGQUIT
    TERMINATED = 128 + signal.SIGTERM


@dataclass(frozen=True)
class RunOutcome:
    """Result of a run."""

    code: Code  # exit code
    reason: str  # reason of the end in one line
    unstopped: str  # why the base could not be commanded to zero; empty if it could
    seconds: float  # duration
    failures: int  # control periods without an IK solution
    timing: Timing  # statistics of the control periods
    time_scale: float = 1.0  # mean speed of the EE motion, relative to the plan
    unclosed: str = ""  # why the backend could not be closed; empty if it could
    task_done: bool | None = None  # whether the task's objects are at their goal, if it has some
    # seconds by which the base follows its commands later than the response model of the robot
    # says; None without a model
    lateness_s: float | None = None


@dataclass(frozen=True)
class Setup:
    """Parts and settings of a run."""

    solver: IkSolver  # IK solver of the robot
    policy: Policy  # policy of the base
    task: Task  # motion and targets
    backend: Backend  # robot or simulated world
    dt: float  # control period in seconds
    config: DeployConfig = field(default_factory=DeployConfig)  # execution, filters and guards
    leading: tuple[CommandFilter, ...] = ()  # filters before those of the configuration
    adapters: tuple[PluginSpec, ...] = ()  # adapters around the backend, the first one innermost
    seconds: float = math.inf  # longest duration
    seed: int = 0  # seed of all random numbers
    solids: Solids | None = None  # solids around the robot, one row; None for those of the task
    real_time: bool = True  # whether a simulated world waits for the clock
    clock: Clock = field(default_factory=Clock)  # clocks

    def __post_init__(self) -> None:
        """Check the guards against `dt`."""
        self.guards.check_rate(self.dt)

    @cached_property
    def guards(self) -> Guards:
        """The limits; those of time do not apply to a world without a clock."""
        guards = self.config.guards
        return guards if self.real_time or self.live else guards.timeless()

    @cached_property
    def live(self) -> bool:
        """Whether the robot moves in real time by itself."""
        return self.backend.real_time is not None


class Signals:
    """A context that handles SIGINT, SIGQUIT, SIGTERM and SIGHUP in the main thread.

    They raise KeyboardInterrupt, but while `noting` the first one is only noted. If it leaves the
    context and the first signal was not SIGINT, SystemExit with the signal's code replaces it.
    A SIGHUP that is ignored, as by nohup, stays ignored. In other threads, nothing is handled.

    Attributes:
        noting: Whether the first signal is only noted.
        caught: First signal, or None.
    """

    def __init__(self) -> None:
        self.noting = False
        self.caught: signal.Signals | None = None
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Self:
        if threading.current_thread() is not threading.main_thread():
            return self
        noted = [signal.SIGINT, signal.SIGQUIT, signal.SIGTERM]
        if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
            noted.append(signal.SIGHUP)
        self._before = {number: signal.signal(number, self._note) for number in noted}
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)
        if kind is KeyboardInterrupt and self.caught and self.caught is not signal.SIGINT:
            raise SystemExit(128 + self.caught)

    def _note(self, number: int, _: FrameType | None) -> None:
        # A SIGHUP after the first signal is ignored: a terminal and its shell both send one.
        passes = self.noting if self.caught is None else number == signal.SIGHUP
        self.caught = self.caught or signal.Signals(number)
        if not passes:
            raise KeyboardInterrupt


def deploy(setup: Setup, recorder: Recorder) -> RunOutcome:
    """Run a policy and return the result; raise KinfeasError if the run cannot start.

    The base is commanded to zero at the end in any case.
    """
    with ExitStack() as stack:
        executor = stack.enter_context(ThreadPoolExecutor(1))
        run = _Run(setup, recorder, executor)
        signals = stack.enter_context(Signals())
        stack.enter_context(closing(run.guarded))
        if setup.live:  # the watchdog needs the connection
            home = run.robot.home["home"]
            run.guarded.reset(IDENTITY[np.newaxis], home[np.newaxis])
        with run.watchdog() as watchdog:
            run.start()
            signals.noting = True
            outcome = run.drive(watchdog, signals)
    return replace(outcome, unclosed=run.guarded.unclosed)


class _Run:
    def __init__(self, setup: Setup, recorder: Recorder, executor: Executor) -> None:
        self.setup, self.recorder = setup, recorder
        self.robot, self.clock = setup.solver.robot, setup.clock
        self.rate = Rate(setup.dt, self.clock, waits=setup.real_time and not setup.live)
        self.guarded = Guarded(
            setup.backend, self.robot, setup.guards, adapters=setup.adapters, rate=self.rate,
            clock=self.clock,
        )  # fmt: skip
        # Without a clock, planners run in the loop, so that runs are repeatable.
        self.timed = setup.real_time or setup.live
        self.loop = assemble(
            setup.solver, build_subgoals(setup.task.subgoals), self.guarded, dt=setup.dt,
            execution=setup.config, filters=(*setup.leading, *setup.config.filters),
            policy=setup.policy, stream=target_stream(setup.task, setup.solver),
            executor=executor if self.timed else None,
        )  # fmt: skip
        self.loop.finds_collisions = False  # nothing here asks for them
        self.rate.prepare = self.prepare
        if setup.backend.real_time is not None:
            setup.backend.real_time.prepare = self.prepare
        self._unwritten: Moment | None = None
        self.steps = self.failures = self._recorded = 0
        self.time_scale, self.scales, self.began = 1.0, 0.0, 0.0

    def watchdog(self) -> Watchdog | nullcontext[None]:
        backend, seconds = self.setup.backend, self.setup.guards.watchdog
        if seconds is None or backend.real_time is None:
            return nullcontext()
        with plugin_note(f"backend {backend.name}"):
            stop_call = backend.real_time.stop_call()
        if stop_call is not None:
            return Watchdog(stop_call, seconds)
        _log.warning(
            "no watchdog: nothing stops the base if this process dies or hangs; backend %s has no "
            "stop_call",
            backend.name,
        )
        return nullcontext()

    def start(self) -> None:
        setup, rng = self.setup, episode_rng(self.setup.seed, 0)
        start = begin(setup.task, setup.solver, rng, self.guarded.read(), setup.solids)
        scans = SCAN_TERMS & set(self.loop.observer.terms)
        if setup.live and scans and self.guarded.scanner is not None:
            self.guarded.scan()  # waits for the first one
        # The targets of a stream are not known yet.
        if self.loop.stream is None and (warning := preflight(self.loop, start, rng, setup.guards)):
            _log.warning("%s", warning)
        self.loop.start(start, [rng])
        end = self.loop.sequence.goal[0]
        if isinstance(setup.task, GoalTask) and distance(end, start.target_poses[0, 0])[0] > 1e-3:
            x, y, z = end[:3].tolist()
            _log.warning(
                "the motion has its own goal: it ends at x %.3g, y %.3g, z %.3g m", x, y, z
            )
        self.loop.measure(self.guarded.refresh())  # planning a motion takes time
        self.began = self.clock.monotonic()
        self.record("start")

    def drive(self, watchdog: Watchdog | None, signals: Signals) -> RunOutcome:
        done: bool | None = None
        try:
            code, reason = self.run(watchdog, signals)
            if code in (Code.REACHED, Code.TIME_OVER):
                self.brake(watchdog)
            if isinstance(task := self.setup.task, StagedTask):
                joints = (self.guarded.state.true_state or self.guarded.state).joint_positions
                reached = code is Code.REACHED
                done = task.task_done(0, joints, self.setup.dt, reached=reached)
                if reached and done is False:
                    code = Code.TIME_OVER
        except (KinfeasError, OSError) as error:
            code, reason = Code.FAULT, str(error)
        except PLUGIN_ERRORS as error:  # a mistake in the code of a plugin, or in ours
            self.guarded.stop()
            _log.exception("the run ends")
            code, reason = Code.FAULT, describe(error)
        except BaseException as error:
            reason = describe(error)
            raise
        finally:
            self.guarded.stop()
            if watchdog is not None and self.guarded.unstopped:
                watchdog.abandon()
            with suppress(*PLUGIN_ERRORS):  # the recorder's `on_moment` may have raised already
                self.record(reason + TASK_DONE[done] + self.doubt())
                self.write()
        timing = self.rate.timing()
        if self.timed and timing.misses > _LATE * timing.periods:
            _log.warning("%d of %d control periods were too long", timing.misses, timing.periods)
        return RunOutcome(
            code, " ".join(reason.split()) + TASK_DONE[done], self.guarded.unstopped,
            self.seconds(), self.failures, timing, self.scales / max(self.steps, 1),
            task_done=done, lateness_s=self.lateness(),
        )  # fmt: skip

    def lateness(self) -> float | None:
        sums = self.loop.response_sums
        return None if sums is None else lateness(sums)

    def doubt(self) -> str:
        late = self.lateness()
        if late is None or abs(late) < _DOUBT:
            return ""
        doubt = (
            f"the base is {abs(late):.2f} s {'later' if late > 0.0 else 'sooner'} than the "
            "response model of the robot; kinfeas identify finds a better one"
        )
        _log.warning("%s", doubt)
        return f"; {doubt}"

    def run(self, watchdog: Watchdog | None, signals: Signals) -> tuple[Code, str]:
        setup, loop = self.setup, self.loop
        # Half a period of tolerance, since periods do not end to the microsecond.
        while self.seconds() + 0.5 * setup.dt < setup.seconds:
            if (caught := signals.caught) is not None:
                by_hand = caught is signal.SIGINT
                by = "interrupted by Ctrl-C" if by_hand else f"ended by {caught.name}"
                return Code(128 + caught), by
            if watchdog is not None and (trouble := watchdog.beat()):
                raise Fault(trouble)
            goal = loop.sequence.goal[0]
            if loop.stream is not None:
                self.guarded.commands.brake = not loop.stream.live[0]
            outcome = loop.step()
            feasible, subgoal = bool(outcome.feasible[0]), int(outcome.subgoal[0])
            self.steps, self.failures = self.steps + 1, self.failures + (not feasible)
            before = self.time_scale
            self.time_scale = loop.execution.time_scale * float(outcome.time_scale[0])
            self.scales += self.time_scale
            after = int(loop.sequence.subgoal[0])
            event = f"time scale {self.time_scale:g}" if self.time_scale != before else ""
            if after > subgoal:
                event = f"sub-goal {after + 1} begins"
            self.record(event, goal, subgoal, feasible=feasible)
            self.guarded.count(feasible=feasible)
            if outcome.finished[0]:
                return Code.REACHED, REACHED
        if loop.stream is not None:
            return Code.REACHED, f"followed the targets for {setup.seconds:g} s"
        return Code.TIME_OVER, f"the goal was not reached within {setup.seconds:g} s"

    def brake(self, watchdog: Watchdog | None) -> None:
        """Bring the base to rest within its acceleration, in at most a second."""
        commands, dt = self.guarded.commands, self.setup.dt
        for _ in range(round(1.0 / dt)):
            if (watchdog is not None and watchdog.beat()) or not commands.base_twist.any():
                return
            self.guarded.step(np.zeros((1, 6)), commands.joint_targets, dt)
            self.record("")

    def seconds(self) -> float:
        if self.timed:
            return self.clock.monotonic() - self.began
        return self.guarded.commands.steps * self.setup.dt

    def prepare(self) -> None:
        # Done while the robot moves, since a disk may be slow.
        self.write()
        self.loop.prepare()

    def write(self) -> None:
        moment, self._unwritten = self._unwritten, None
        if moment is not None:
            self.recorder.write(moment)

    def record(
        self, event: str, goal: Array | None = None, subgoal: int | None = None, *,
        feasible: bool = True,
    ) -> None:  # fmt: skip
        self.write()
        loop, state, (twist, targets) = self.loop, self.guarded.state, self.guarded.command
        recorded, self._recorded = self._recorded, self.guarded.commands.steps
        if recorded == self._recorded:  # nothing was sent since the last line but a stop
            twist = np.zeros((1, 6))
        self._unwritten = Moment(
            time=self.seconds(),
            age=math.nan if state.age is None else float(state.age[0]),
            base_pose=state.base_pose[0].copy(),  # backends may write into theirs
            joint_positions=state.joint_positions[0].copy(),
            desired=loop.desired[0],
            goal=loop.sequence.goal[0] if goal is None else goal,
            base_twist=twist[0],
            joint_targets=targets[0],
            feasible=feasible,
            subgoal=int(loop.sequence.subgoal[0]) if subgoal is None else subgoal,
            event=event,
        )
