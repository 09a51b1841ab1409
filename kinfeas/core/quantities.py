"""Types of numbers with units and bounds; the bounds catch mistakes and prevent overflows."""

from typing import Annotated

from annotated_types import Interval

FARTHEST, LONGEST = 1e4, 1e5
"""Largest length in metres and time in seconds."""

REMOTEST = 1e8
"""Largest number in records of robots, metres."""

MOST_EPISODES, MOST_PROCESSES, LAST_SEED = 1_000_000, 256, 2**32 - 1

TIME_SCALES = Interval(ge=0.001, le=1.0)
"""Speeds of motions relative to the plan."""

Metres = Annotated[float, Interval(ge=-FARTHEST, le=FARTHEST)]
Distance = Annotated[float, Interval(ge=0.0, le=FARTHEST)]
Radians = Annotated[float, Interval(ge=-1e4, le=1e4)]
Seconds = Annotated[float, Interval(ge=0.0, le=LONGEST)]
PositiveSeconds = Annotated[float, Interval(gt=0.0, le=LONGEST)]
TimeScale = Annotated[float, TIME_SCALES]
Count = Annotated[int, Interval(ge=1)]
Episodes = Annotated[int, Interval(ge=1, le=MOST_EPISODES)]
Processes = Annotated[int, Interval(ge=1, le=MOST_PROCESSES)]
ControlPeriod = Annotated[float, Interval(ge=0.001, le=1.0)]
Rate = Annotated[float, Interval(ge=1.0, le=1000.0)]
Seed = Annotated[int, Interval(ge=0, le=LAST_SEED)]
NotNegative = Annotated[float, Interval(ge=0.0)]
Positive = Annotated[float, Interval(gt=0.0)]
Fraction = Annotated[float, Interval(ge=0.0, le=1.0)]
PositiveFraction = Annotated[float, Interval(gt=0.0, le=1.0)]

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
Position = tuple[Metres, Metres, Metres]
