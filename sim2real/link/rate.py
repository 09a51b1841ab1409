"""A fixed control rate: absolute deadlines, and statistics of times."""

import math
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from kinfeas.core.errors import KinfeasError

_LATE = 1.5  # control periods after which a period that the robot times itself counts as late
_KEPT = 180_000  # number of last periods from which percentiles are computed: an hour at 50 Hz


@dataclass(frozen=True)
class Clock:
    """The clocks of a run; tests have simulated ones."""

    monotonic: Callable[[], float] = time.monotonic  # seconds of a clock that is never set
    wall: Callable[[], float] = time.time  # seconds of the system's clock
    sleep: Callable[[float], None] = time.sleep  # waits for a number of seconds


@dataclass(frozen=True)
class Timing:
    """Statistics of control periods, in seconds."""

    periods: int  # number of periods
    p50: float  # median of the last `_KEPT`, as the other percentiles
    p99: float  # 99th percentile
    longest: float  # maximum
    misses: int  # number of periods that ended after their deadline
    # median of the computing time from a measurement to its command, or None
    work_p50: float | None = None
    work_p99: float | None = None  # 99th percentile of it, or None


class Rate:
    """Measures control periods, and waits for their ends unless the robot times them.

    Deadlines are multiples of the period: a late period does not shift later ones, and deadlines
    that have passed are skipped.

    Attributes:
        prepare: Work without measurements, done shortly before the end of a period; None for none.
    """

    def __init__(self, dt: float, clock: Clock | None = None, *, waits: bool = True) -> None:
        """Start at the first `wait`; periods take `dt` seconds."""
        if not 0.0 < dt < math.inf:
            raise KinfeasError(f"the control period must be above 0 s and finite, not {dt}")
        self.dt, self._clock, self.waits = dt, clock or Clock(), waits
        self.prepare: Callable[[], None] | None = None
        self._preparing = dt / 4.0
        self._deadline = self._last = math.nan
        self._periods, self._work = deque[float](maxlen=_KEPT), deque[float](maxlen=_KEPT)
        self._count, self._misses, self._longest = 0, 0, 0.0

    def restart(self) -> None:
        """Begin a period now, and forget the one before."""
        self._last = self._clock.monotonic()
        self._deadline = self._last + self.dt

    def wait(self) -> float:
        """Return the length of the control period that ends now, in seconds, at first 0.

        Waits for its end, unless the robot times it.
        """
        if math.isnan(self._last):
            self.restart()
            return 0.0
        now = self._clock.monotonic()
        if self.waits:
            self._misses += now > self._deadline
            self._prepare()
            now = self._sleep(self._deadline)
            self._deadline += self.dt * (1 + math.floor(max(0.0, now - self._deadline) / self.dt))
        else:
            self._misses += now - self._last > _LATE * self.dt
        period, self._last = now - self._last, now
        self._periods.append(period)
        self._count, self._longest = self._count + 1, max(self._longest, period)
        return period

    def _prepare(self) -> None:
        """Do the work of `prepare` so that it ends before the deadline, but not long before it.

        Caches are cold after a sleep; the work warms them for the step that follows.
        """
        begin = self._deadline - 2.0 * self._preparing
        if self.prepare is not None and self._clock.monotonic() < begin:
            began = self._sleep(begin)
            self.prepare()
            self._preparing = min(self._clock.monotonic() - began, self.dt / 4.0)

    def _sleep(self, end: float) -> float:
        while (now := self._clock.monotonic()) < end:
            self._clock.sleep(end - now)
        return now

    def worked(self) -> None:
        """Note that computing has ended: the command of this period is about to be sent."""
        if not math.isnan(self._last):
            self._work.append(self._clock.monotonic() - self._last)

    def timing(self) -> Timing:
        """Return the statistics so far; zeros without a period."""
        if not self._count:
            return Timing(0, 0.0, 0.0, 0.0, 0)
        p50, p99 = np.percentile(self._periods, (50.0, 99.0)).tolist()
        work = np.percentile(self._work, (50.0, 99.0)).tolist() if self._work else ()
        return Timing(self._count, p50, p99, self._longest, self._misses, *work)
