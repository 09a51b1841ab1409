"""When stamped measurements can have arrived at the earliest, by our own clock."""

import math

DRIFT = 1e-3
"""Share by which a robot's clock may be slower than ours, usually: twice the most that NTP slews
by."""


class Stamps:
    """The stamps of one part of a robot, seen from our clock, which it is not set by.

    Of all that arrived, the least of arrival minus stamp is what lies between the clocks and the
    shortest way. A measurement counts from its stamp and that: one that waited in a queue before it
    arrived is as old as it is, and so is one that is sent again. A constant difference between the
    clocks says nothing, nor does a stamp that jumps ahead, from which on all is counted anew.
    A robot's clock that is slower than expected, such as that of a simulator that does not keep up,
    looks like a queue that falls behind.

    Attributes:
        last: The stamp that was seen last, seconds.
    """

    def __init__(self, drift: float = DRIFT) -> None:
        """Begin; `drift`, below 1, is the share by which the robot's clock may be slower."""
        self.last, self._least = -math.inf, math.inf
        self._lag = drift / (1.0 - drift)  # for each of its own seconds

    def since(self, stamp: float, arrival: float) -> float:
        """Return since when a measurement is on its way, seconds of our clock, `arrival` at most.

        Args:
            stamp: By the robot's clock, seconds; one before the last is as much older.
            arrival: By our clock, seconds.
        """
        slower = self._lag * (stamp - self.last)
        self.last, self._least = stamp, min(arrival - stamp, self._least + slower)
        return min(arrival, stamp + self._least)
