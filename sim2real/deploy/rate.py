"""A fixed rate: absolute deadlines on the monotonic clock, and how well they were kept."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from kinfeas.core.errors import KinfeasError

LATE = 1.5
"""A period of so many control periods has missed its deadline, where another keeps the time."""


@dataclass(frozen=True)
class Timing:
    """How regular the control periods were; all of them in seconds.

    Attributes:
        periods: How many were measured.
        p50: Their median.
        p99: What one in a hundred of them exceeds.
        longest: The longest of them.
        misses: How many ended after their deadline.
        work_p50: Median of what there was to do in a period; None where another keeps the time.
        work_p99: What one in a hundred of them exceeds; None likewise.
    """

    periods: int
    p50: float
    p99: float
    longest: float
    misses: int
    work_p50: float | None = None
    work_p99: float | None = None


class Rate:
    """Ends every control period at its time.

    The deadlines are those of a clock that never lost a beat: a late period does not shift those
    after it. Deadlines that have passed meanwhile are left out, never made up for in haste.
    """

    def __init__(
        self,
        dt: float,
        *,
        now: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        """Make a metronome; the first `wait` or `tick` sets it going.

        Args:
            dt: Control period in seconds.
            now: The clock, in seconds; it never goes backwards.
            sleep: Waits for so many seconds.

        Raises:
            KinfeasError: If `dt` is not a finite number above 0.
        """
        if not 0.0 < dt < math.inf:
            raise KinfeasError(f"the control period must be a finite number above 0 s, not {dt}")
        self.dt, self._now, self._sleep = dt, now, sleep
        self._deadline = self._last = math.nan
        self._periods: list[float] = []
        self._work: list[float] = []
        self._misses = 0

    def wait(self) -> float:
        """Wait for the end of the control period; return its measured length in seconds.

        The first call only sets the metronome going, and returns 0.
        """
        now = self._now()
        if math.isnan(self._last):
            self._last, self._deadline = now, now + self.dt
            return 0.0
        self._work.append(now - self._last)
        if now > self._deadline:
            self._misses += 1
        while now < self._deadline:
            self._sleep(self._deadline - now)
            now = self._now()
        self._deadline += self.dt * (1 + math.floor(max(0.0, now - self._deadline) / self.dt))
        return self._measure(now)

    def tick(self) -> float:
        """Return the length of the period that ends now, whose end another has waited for.

        It is late where it took `LATE` control periods. The first call returns 0.
        """
        now = self._now()
        if math.isnan(self._last):
            self._last = now
            return 0.0
        if now - self._last > LATE * self.dt:
            self._misses += 1
        return self._measure(now)

    def timing(self) -> Timing:
        """Return how regular the periods were so far; zeros if none was measured."""
        if not self._periods:
            return Timing(0, 0.0, 0.0, 0.0, 0)
        p50, p99 = _median_and_tail(self._periods)
        longest, work = max(self._periods), _median_and_tail(self._work) if self._work else ()
        return Timing(len(self._periods), p50, p99, longest, self._misses, *work)

    def _measure(self, now: float) -> float:
        period, self._last = now - self._last, now
        self._periods.append(period)
        return period


def _median_and_tail(seconds: list[float]) -> tuple[float, float]:
    p50, p99 = np.percentile(seconds, (50.0, 99.0)).tolist()
    return p50, p99
