"""A run on a robot: the loop, a policy and a clock, behind guards, written down step by step."""

import signal
import sys
import traceback
from contextlib import ExitStack, closing, nullcontext, suppress
from dataclasses import replace
from typing import Any

import numpy as np

from kinfeas.control.adapters import execution_of
from kinfeas.control.drive import action_size
from kinfeas.control.loop import Loop
from kinfeas.core.errors import PLUGIN_ERRORS, KinfeasError, plugin_note
from kinfeas.core.spatial import IDENTITY, Array
from kinfeas.core.start import episode_rng
from kinfeas.io.run_log import REACHED, TASK_DONE, Moment, Recorder
from kinfeas.sim2real.deploy.deployment import Code, Outcome, Setup, TaskWithObjects
from kinfeas.sim2real.deploy.goal_task import begin
from kinfeas.sim2real.deploy.guards import Guarded, check_action
from kinfeas.sim2real.deploy.preflight import preview
from kinfeas.sim2real.deploy.rate import Rate
from kinfeas.sim2real.deploy.rollout_planner_thread import RolloutPlannerThread
from kinfeas.sim2real.deploy.signals import Signals
from kinfeas.sim2real.deploy.watchdog import StopCall, Watchdog, Watched
from kinfeas.sim2real.link.fault import Fault
from kinfeas.tasks.task import build_subgoals

__all__ = ["Code", "Outcome", "Setup", "deploy"]


def deploy(setup: Setup, recorder: Recorder) -> Outcome:
    """Return how a run ended; whatever happens in it, the base is commanded to zero at its end.

    Raises:
        KinfeasError: If it cannot begin.
    """
    run = _Run(setup, recorder)
    with ExitStack() as stack:
        for one in setup.filters:
            if isinstance(one, RolloutPlannerThread):
                stack.enter_context(closing(one))
        signals = stack.enter_context(Signals())
        stack.enter_context(closing(run.guarded))
        run.connect()
        with run.watch() as watchdog:
            run.start()
            outcome = run.drive(watchdog, signals)
    return replace(outcome, unclosed=run.guarded.unclosed)


class _Run:
    """One run, from its first measurement to its last command."""

    def __init__(self, setup: Setup, recorder: Recorder) -> None:
        self.setup, self.recorder, self.live = setup, recorder, setup.live
        self.robot = setup.solver.robot
        self.rate = Rate(setup.dt, now=setup.clocks.steady)
        self.waits = setup.real_time and self.live is None
        self.keeps_time = setup.real_time or self.live is not None
        self.guarded = Guarded(
            setup.backend,
            self.robot,
            setup.guards,
            adapters=setup.adapters,
            rate=self.rate if self.waits else None,
            clocks=setup.clocks,
        )
        execution = execution_of(self.guarded, setup.execution)
        self.loop = Loop(
            setup.solver,
            build_subgoals(setup.task.subgoals),
            self.guarded,
            setup.dt,
            execution,
            setup.filters,
        )
        self.loop.set_policy(setup.policy)
        self.steps = self.failures = 0
        self.began = 0.0

    def connect(self) -> None:
        """Wait for the first measurement of a robot that moves by its own clock."""
        if self.live is not None:
            home = self.robot.home["home"]
            self.guarded.reset(IDENTITY[np.newaxis], home[np.newaxis])

    def watch(self) -> Watchdog | nullcontext[None]:
        """Return what stops the base should this process die or hang, if anything does."""
        backend, seconds = self.setup.backend, self.setup.guards.watchdog
        if seconds is not None and isinstance(backend, Watched):
            return Watchdog(_stop_call(backend), seconds)
        if seconds is not None and self.live is not None:
            sys.stderr.write(
                f"no watchdog: nothing stops the base if this process dies or hangs, for "
                f"{type(backend).__name__} has no stop_call\n"
            )
        return nullcontext()

    def start(self) -> None:
        """Put the robot where the run begins, or begin it where it stands."""
        rng = episode_rng(self.setup.seed, 0)
        start = begin(self.setup.task, self.setup.solver, rng, self.guarded.look())
        if warning := preview(self.loop, start, rng, self.setup.guards):
            sys.stderr.write(f"{warning}\n")
        self.loop.start(start, [rng])
        self.began = self.setup.clocks.steady()
        self.note("start")

    def drive(self, watchdog: Watchdog | None, signals: Signals) -> Outcome:
        """Go on until something ends it, and command the base to zero."""
        reason, done = "stopped by an error", None
        try:
            code, reason = self.go(watchdog, signals)
            if isinstance(self.setup.task, TaskWithObjects):
                state = self.guarded.state.true_state or self.guarded.state
                self.setup.task.settle(state.joint_positions, self.setup.dt)
                done = self.setup.task.done()
        except (KinfeasError, OSError) as error:
            code, reason = Code.FAULT, str(error)
        except PLUGIN_ERRORS as error:
            # A mistake in somebody's code, who needs to know where.
            self.guarded.stop()
            traceback.print_exc()
            code, reason = Code.FAULT, f"{type(error).__name__}: {error}"
        finally:
            self.guarded.stop()
            if watchdog is not None and self.guarded.unstopped:
                watchdog.abandon()
            raised = sys.exception()
            with suppress(KinfeasError):
                end = reason if raised is None else f"{type(raised).__name__}: {raised}"
                self.note(end + TASK_DONE[done])
        return Outcome(
            code,
            " ".join(reason.split()),
            self.guarded.unstopped,
            self.lasted(),
            self.failures,
            self.rate.timing(),
            task_done=done,
        )

    def go(self, watchdog: Watchdog | None, signals: Signals) -> tuple[Code, str]:
        """Take one step after the other; return how and why the last one was the last."""
        setup, loop, size = self.setup, self.loop, action_size(self.robot.base)
        # Half a period, for none ends to the microsecond.
        while self.lasted() + 0.5 * setup.dt < setup.seconds:
            if signals.caught is not None:
                return _ended_by(signals.caught)
            if watchdog is not None and not watchdog.beat():
                raise Fault("the watchdog has stopped the base, or has died or stalled")
            goal = loop.goal[0]
            step = loop.step(check_action(setup.policy.act(loop.policy_input), size))
            if not self.waits:
                self.rate.tick()
            feasible, subgoal = bool(step.feasible[0]), int(step.subgoal[0])
            self.steps, self.failures = self.steps + 1, self.failures + (not feasible)
            after = int(loop.sequence.subgoal[0])
            event = f"sub-goal {after + 1} begins" if after > subgoal else ""
            self.note(event, goal, subgoal, feasible=feasible)
            self.guarded.judge(feasible=feasible)
            if step.finished[0]:
                return Code.REACHED, REACHED
        return Code.TIME_OVER, f"the goal was not reached within {setup.seconds:g} s"

    def lasted(self) -> float:
        """Return the seconds since the start: by the clock, if the world keeps to one."""
        if self.keeps_time:
            return self.setup.clocks.steady() - self.began
        return self.steps * self.setup.dt

    def note(
        self,
        event: str,
        goal: Array | None = None,
        subgoal: int | None = None,
        *,
        feasible: bool = True,
    ) -> None:
        """Write down where the robot is and what it was commanded.

        Goal and sub-goal are those of the step that has ended, if they have changed with it.
        """
        loop, guarded, state = self.loop, self.guarded, self.guarded.state
        self.recorder.write(
            Moment(
                time=self.lasted(),
                age=float("nan") if state.age is None else float(np.max(state.age)),
                base_pose=state.base_pose[0],
                joint_positions=state.joint_positions[0],
                desired=loop.desired[0],
                goal=loop.goal[0] if goal is None else goal,
                base_twist=guarded.base_twist[0],
                joint_targets=guarded.joint_targets[0],
                feasible=feasible,
                subgoal=int(loop.sequence.subgoal[0]) if subgoal is None else subgoal,
                event=event,
            )
        )


def _stop_call(backend: Watched) -> StopCall:
    """Return how another process stops the base, if the backend says it."""
    with plugin_note(f"backend {type(backend).__name__}"):
        call: Any = backend.stop_call()
    if not isinstance(call, StopCall):
        name, got = type(backend).__name__, type(call).__name__
        raise KinfeasError(f"backend {name} must return a StopCall from stop_call, not {got}")
    return call


def _ended_by(caught: signal.Signals) -> tuple[Code, str]:
    """Return how and why a run ends that a signal was sent to."""
    by = "interrupted by Ctrl-C" if caught is signal.SIGINT else f"ended by {caught.name}"
    return Code(128 + caught), by
