"""Types of numbers with units and bounds; the bounds catch mistakes and prevent overflows."""

from typing import Annotated

from kinfeas.config import Interval

FARTHEST, LONGEST = 1e4, 1e5
"""Largest length in metres and time in seconds."""

REMOTEST = 1e8
"""Largest number in records of robots, metres."""

MOST_EPISODES, MOST_PROCESSES, LAST_SEED = 1_000_000, 256, 2**32 - 1

TIME_SCALES = Interval(low=0.001, high=1.0)
"""Speeds of motions relative to the plan."""

Metres = Annotated[float, Interval(low=-FARTHEST, high=FARTHEST)]
Distance = Annotated[float, Interval(low=0.0, high=FARTHEST)]
Radians = Annotated[float, Interval(low=-1e4, high=1e4)]
Seconds = Annotated[float, Interval(low=0.0, high=LONGEST)]
PositiveSeconds = Annotated[float, Interval(low=0.0, high=LONGEST, open_low=True)]
TimeScale = Annotated[float, TIME_SCALES]
Count = Annotated[int, Interval(low=1)]
Episodes = Annotated[int, Interval(low=1, high=MOST_EPISODES)]
NotNegative = Annotated[float, Interval(low=0.0)]
Positive = Annotated[float, Interval(low=0.0, open_low=True)]
Share = Annotated[float, Interval(low=0.0, high=1.0)]
PositiveShare = Annotated[float, Interval(low=0.0, high=1.0, open_low=True)]

Vector = tuple[float, float, float]
Position = tuple[Metres, Metres, Metres]
