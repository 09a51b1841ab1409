"""Numbers of files and options by what they measure, and within what bounds.

Lengths, angles and times are as large as a robot can have a use for: larger ones are mistakes, and
would end in an overflow, or never.
"""

from typing import Annotated

from kinfeas.config import Interval

FARTHEST, LONGEST = 1e4, 1e5
"""Metres and seconds: ten kilometres, and a little more than a day."""

REMOTEST = 1e8
"""What a recorded number may be: metres from the origin of any map on earth."""

Metres = Annotated[float, Interval(low=-FARTHEST, high=FARTHEST)]
Distance = Annotated[float, Interval(low=0.0, high=FARTHEST)]
Radians = Annotated[float, Interval(low=-1e4, high=1e4)]
Seconds = Annotated[float, Interval(low=0.0, high=LONGEST)]
PositiveSeconds = Annotated[float, Interval(low=0.0, high=LONGEST, open_low=True)]

Count = Annotated[int, Interval(low=1)]
NotNegative = Annotated[float, Interval(low=0.0)]
Positive = Annotated[float, Interval(low=0.0, open_low=True)]
Share = Annotated[float, Interval(low=0.0, high=1.0)]
PositiveShare = Annotated[float, Interval(low=0.0, high=1.0, open_low=True)]

MOST_EPISODES, MOST_PROCESSES = 1_000_000, 256
"""What a machine can be asked for: days of episodes, and a process for each core."""

LAST_SEED = 2**32 - 1
"""The last one that all generators of random numbers take."""

Episodes = Annotated[int, Interval(low=1, high=MOST_EPISODES)]

Vector = tuple[float, float, float]
Position = tuple[Metres, Metres, Metres]

TIME_SCALES = Interval(low=0.001, high=1.0)
"""Allowed speeds of a motion as shares of the planned one."""

TimeScale = Annotated[float, TIME_SCALES]
