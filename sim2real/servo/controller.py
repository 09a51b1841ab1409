"""The controller of a servo run: takes targets from any thread and hands them to the loop."""

import logging
import math
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kinfeas.control.period import Period
from kinfeas.control.targets import RULES, StreamProgress, TargetInbox, TargetRules, interpolated
from kinfeas.core import spatial
from kinfeas.core.errors import Fault
from kinfeas.core.motion import Rows
from kinfeas.core.spatial import Array
from kinfeas.core.start import Start
from kinfeas.kinematics.ik import IkSolver
from kinfeas.robots.robot import Robot
from kinfeas.sim2real.servo.messages import (
    Frames,
    Message,
    SenderClock,
    chunk_in_world,
    why_invalid,
)
from kinfeas.tasks.task import MotionSpec, Subgoal, start_at_home

_MOST_POSES = 64  # of a chunk
_QUEUE = 256  # messages in a control period; older ones are dropped
_LONG = 2.0  # s after which ignored messages are reported
_ROW = np.zeros(1, dtype=np.intp)

_log = logging.getLogger(__name__)


class TargetController:
    """Targets of one EE: the task of a run, its target stream, and a filter that stops the base.

    Messages may come from any thread, at any rate and with any content: those that `TargetRules`
    exclude are counted and ignored. A warning is logged if all are ignored for `_LONG` seconds.
    Stamps and times are of the sender's clock, as in `SenderClock`. A message without a stamp
    counts as sent when it arrives.

    Attributes:
        pose: World pose of the EE that is desired now, shape (7,), once `running`.
        running: Whether the loop reads the messages.
    """

    name, seconds = "servo", math.inf  # the run has its own limit

    def __init__(
        self,
        robot: Robot,
        rules: TargetRules | None = None,
        clock: Callable[[], float] = time.monotonic,
        motion: MotionSpec | None = None,
    ) -> None:
        """Take chunks of at most 64 poses; `clock` returns seconds, `motion` moves the EE."""
        self.subgoals = (Subgoal(motion or MotionSpec("servo")),)
        self.robot, self.rules, self._clock = robot, rules or TargetRules(), clock
        self.pose, self.running = spatial.IDENTITY, False
        self._inbox = TargetInbox(self.rules, _MOST_POSES)
        self._queue: deque[Message] = deque(maxlen=_QUEUE)
        self._kept: deque[tuple[float, Array, Array, Array]] = deque(maxlen=_QUEUE)
        self._frames = Frames(robot)
        self._lock = threading.Lock()
        self._sender = SenderClock(self.rules.timeout)
        self._others = dict.fromkeys(("ahead", "frame", "dropped"), 0)
        self._ignored: tuple[float, float, dict[str, int]] | None = None  # since, until, before
        self._late = 0  # accepted messages that came after the one before had expired
        self._failure, self._last = "", ("", "")  # rule and reason of the last ignored message

    def sample(self, solver: IkSolver, rng: np.random.Generator) -> Start:
        """Return the start at the origin with the arm at home."""
        return start_at_home(solver.robot)

    def target_stream(self, solver: IkSolver) -> Self:
        """Return the controller."""
        return self

    def set_target(self, pose: ArrayLike, stamp: float | None = None, frame: str = "") -> None:
        """Send the EE to a pose (7,) in the world, base or EE frame, by its name.

        `stamp` is the time of the pose and of its frame, in seconds of the sender's clock.
        """
        self._put(pose, stamp, None, frame)

    def set_twist(self, twist: ArrayLike, stamp: float | None = None, frame: str = "") -> None:
        """Move the EE at a twist (6,), m/s and rad/s, along the axes of a frame."""
        self._put(twist, stamp, None, frame, is_twist=True)

    def set_chunk(  # noqa: PLR0913 - keywords of a public call
        self,
        poses: ArrayLike,
        times: ArrayLike,
        stamp: float | None = None,
        frame: str = "",
        *,
        relative: bool = False,
        observed: float | None = None,
        keep: float = 0.0,
    ) -> None:
        """Lead the EE along poses (k, 7) at ascending times (k,) in place of the last chunk.

        Args:
            poses: Shape (k, 7), or (k, 9) as of `spatial.from_columns`.
            times: Of the sender's clock, or of our `clock` without a stamp.
            stamp: When the chunk was sent, by the sender's clock.
            frame: World, base or EE frame, by its name, at the time of the observation.
            relative: Whether poses are relative to the EE pose that was desired at the time of the
                observation, not of the arrival; the same as the name of the EE frame.
            observed: Time of the policy's observation, by the clock of `times`; by default that of
                sending. Chunks of older observations than the last one are ignored.
            keep: Seconds from the observation during which the last chunk stays, as in real-time
                chunking; at least until the arrival.
        """
        frame = self.robot.ee_frame if relative else frame
        self._put(poses, stamp, times, frame, observed, keep)

    @property
    def live(self) -> NDArray[np.bool_]:
        """Whether the last message is not too old, shape (1,)."""
        return self._inbox.live

    @property
    def counts(self) -> dict[str, int]:
        """Number of messages by `RULES`, `ahead`, unknown `frame` or `dropped` for lack of room."""
        counts = dict(zip(RULES, self._inbox.counts.sum(axis=0).tolist(), strict=True))
        return counts | self._others

    def fail(self, reason: str) -> None:
        """Let the next period raise Fault with a reason, from any thread."""
        self._failure = reason

    def start(self, desired: Array, rngs: Sequence[np.random.Generator], rows: Rows) -> None:
        """Rest where the EE is; earlier messages are dropped."""
        with self._lock:
            self._queue.clear()
        self._kept.clear()
        self._frames = Frames(self.robot)
        self._inbox.start(desired)

    def targets(self, progress: StreamProgress) -> Array:
        """Return the target of the next period, shape (1, 7); raise Fault after `fail`."""
        if self._failure:
            raise Fault(self._failure)
        with self._lock:
            messages = list(self._queue)
            self._queue.clear()
        now = np.array([self._clock()])
        self.pose, self.running = progress.desired[0], True
        base_pose, delay = progress.base_pose[0], progress.delay
        self._frames.append(float(now[0]), base_pose, self.pose, delay)
        if messages or self._kept:
            before, waited = self.counts, not self.live[0]
            for message in messages:
                self._read(message, now)
            self._put_kept(now)
            self._late += waited and self.counts["accepted"] > before["accepted"]
            self._watch(before, float(now[0]))
        rows, dt = progress.rows, progress.dt
        self._inbox.wait(rows, progress.time_scale, progress.desired)
        self._inbox.advance(rows, now, dt, progress.motion_seconds)
        return self._inbox.target

    @property
    def speed(self) -> Array:
        """Requested speed of the EE in the next period, shape (1,), m/s."""
        return self._inbox.speed

    def snapshot(self) -> dict[str, NDArray[Any]]:
        """Return the state as arrays by name."""
        return self._inbox.snapshot()

    def restore(self, snapshot: dict[str, NDArray[Any]]) -> None:
        """Continue from a state that `snapshot` returned."""
        self._inbox.restore(snapshot)

    def __call__(self, period: Period) -> Period:
        """Return the period, with a base at rest after the end of the stream."""
        return period if self.live[0] else period.commanded(np.zeros_like(period.command))

    def _put(  # noqa: PLR0913 - the fields of a message
        self, values: ArrayLike, stamp: float | None, times: ArrayLike | None, frame: str,
        observed: float | None = None, keep: float = 0.0, *, is_twist: bool = False,
    ) -> None:  # fmt: skip
        arrival = self._clock()
        try:  # copies, since the sender may write into its arrays
            message = Message(
                arrival,
                None if stamp is None else float(stamp),
                np.array(values, dtype=np.float64, ndmin=1),
                None if times is None else np.array(times, dtype=np.float64, ndmin=1),
                frame,
                None if observed is None else float(observed),
                float(keep),
                is_twist,
            )
        except (TypeError, ValueError, OverflowError):
            message = Message(arrival, None, None)
        with self._lock:
            self._others["dropped"] += self.running and len(self._queue) == _QUEUE
            self._queue.append(message)

    def _watch(self, before: dict[str, int], now: float) -> None:
        """Warn once if all messages are ignored for long; `before` are the counts a period ago."""
        if self.counts == before:
            return
        if self.counts["accepted"] > before["accepted"]:
            self._ignored = None
            return
        since, last, counts = self._ignored or (now, now, before)
        if now - last > _LONG:
            since, counts = now, before
        self._ignored = since, now, counts
        if last - since < _LONG <= now - since:
            new = {rule: n - counts[rule] for rule, n in self.counts.items()}
            _log.warning("all messages are ignored, for %.1f s: %s", now - since, self._why(new))

    @property
    def refusal(self) -> str:
        """Why no message was accepted; empty if one was."""
        counts = self.counts
        return "" if counts["accepted"] else f"no message was accepted: {self._why(counts)}"

    @property
    def hint(self) -> str:
        """Hint that most messages came after the one before had expired; empty otherwise."""
        if self._late - 1 <= 0.5 * self.counts["accepted"]:
            return ""
        seconds = self.rules.timeout
        return f"most messages came later than rules.timeout, {seconds:g} s, after the last one"

    def _why(self, counts: dict[str, int]) -> str:
        rules = ", ".join(f"{n} {rule}" for rule, n in counts.items() if n) or "none came"
        rule, reason = self._last
        return rules + (f"; the last {rule}: {reason}" if counts.get(rule) else "")

    def _read(self, message: Message, now: Array) -> None:
        values, times, stamp = message.values, message.times, message.stamp
        numbers = [stamp or 0.0, message.observed or 0.0, message.keep]
        if values is None or not (np.isfinite(numbers).all() and np.isfinite(values).all()):
            self._reject("no array of finite numbers")
            return
        if message.frame not in self._frames:
            self._others["frame"] += 1
            self._last = "frame", f"{message.frame!r}, not {', '.join(self._frames.names)}"
            return
        arrival, observed = message.arrival, message.observed
        sent = arrival if stamp is None else self._sender.sent(stamp, arrival)
        offset = 0.0 if sent is None or stamp is None else sent - stamp
        when = sent if sent is None or observed is None else observed + offset
        if when is None or when - arrival > 0.5 * self.rules.timeout:
            self._others["ahead"] += 1
            return
        frame = self._frames.at(message.frame, when)
        if frame is None:
            self._inbox.reject(_ROW, "late")
            return
        if message.is_twist and values.shape == (6,):
            points = np.tile(spatial.IDENTITY, (2, 1))
            points[:, :3] = values.reshape(2, 3)
            twist = spatial.compose(np.tile(frame, (2, 1)), points)[:, :3] - frame[:3]
            self._inbox.put_twists(_ROW, now, np.array([when]), twist.reshape(1, 6))
            return
        chunk = None if message.is_twist else chunk_in_world(values, times, frame, when, offset)
        if chunk is None:
            poses = "pose (7,), or poses (k, 7) with unit quaternions and ascending times"
            expected = "twist (6,)" if message.is_twist else poses
            count = "" if times is None else f" with {len(times)} times"
            self._reject(f"no {expected}, but shape {values.shape}{count}")
            return
        self._kept.append((when + message.keep, np.array([when]), *chunk))
        self._put_kept(now)

    def _reject(self, why: str) -> None:
        self._inbox.reject(_ROW)
        self._last = "invalid", why

    def _put_kept(self, now: Array) -> None:
        """Take the chunks whose `keep` seconds are over: until then the last chunk stays."""
        for _ in range(len(self._kept)):
            due, sent, times, poses = self._kept.popleft()
            if due <= now[0]:
                before = self.counts
                self._inbox.put_poses(_ROW, now, sent, times, poses)
                if self.counts["invalid"] > before["invalid"]:
                    self._last = "invalid", why_invalid(times[0], poses[0], _MOST_POSES)
                elif self.counts["jump"] > before["jump"]:
                    aims = interpolated(now, times, poses)
                    metres, radians = spatial.distance(self._inbox.target, aims)
                    limits = f"limits {self.rules.max_jump:g} m, {self.rules.max_turn:g} rad"
                    self._last = "jump", f"{metres[0]:.2f} m, {radians[0]:.2f} rad; {limits}"
            elif (due > times[0, -1:] + self.rules.timeout).any():
                self._inbox.reject(_ROW, "late")
                self._last = "late", f"'keep', {due - sent[0]:g} s, ends after its last pose"
            else:
                self._kept.append((due, sent, times, poses))


class TargetSource(Protocol):
    """Sends targets to a controller, from a thread of its own."""

    def start(self, controller: TargetController) -> None:
        """Begin to send."""

    def close(self) -> None:
        """End; it may be called twice."""
