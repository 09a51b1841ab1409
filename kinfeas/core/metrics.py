"""Metrics of episodes: success with confidence intervals, IK failures, deviations, joint jumps."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import TypedDict, TypeVar

import numpy as np
from numpy.typing import NDArray

from kinfeas.core.spatial import Array

GOAL_METRES, GOAL_RADIANS = 0.025, float(np.deg2rad(12.0))
"""Tolerances of a goal, which must be reached on a feasible step."""

WITHIN = 0.05
"""Metres that the EE may stray in an episode that counts as within 5 cm."""


@dataclass(frozen=True)
class EpisodeRecords:
    """What happened in n episodes.

    Attributes:
        reached: Whether the goal, the end of the last sub-goal, was reached, shape (n,).
        failures: Steps without an IK solution, shape (n,).
        max_deviation: Largest distance of the EE from the desired position, metres, shape (n,).
        mean_deviation: Mean of that distance over the episode, metres, shape (n,).
        final_distance: Distance of the EE from the goal at the end, metres, shape (n,); infinite
            where the last sub-goal was never begun.
        joint_jumps: Steps in which a joint moved faster than its limit, shape (n,).
        steps: Length of the episode, shape (n,).
    """

    reached: NDArray[np.bool_]
    failures: NDArray[np.intp]
    max_deviation: Array
    mean_deviation: Array
    final_distance: Array
    joint_jumps: NDArray[np.intp]
    steps: NDArray[np.intp]

    @property
    def success(self) -> NDArray[np.bool_]:
        """Whether the goal was reached without one kinematic failure, shape (n,)."""
        return self.reached & (self.failures == 0)

    @property
    def within(self) -> NDArray[np.bool_]:
        """Whether the EE never strayed by more than `WITHIN` and ended as near, shape (n,)."""
        return (self.max_deviation <= WITHIN) & (self.final_distance <= WITHIN)


Records = TypeVar("Records", bound=EpisodeRecords)


def join(parts: Sequence[Records]) -> Records:
    """Return the episodes of all parts, one after the other; there is at least one part."""
    names = [entry.name for entry in fields(parts[0])]
    joined = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
    return type(parts[0])(**joined)


@dataclass(frozen=True)
class Share:
    """A share of episodes with its 95 % Wilson interval, all in 0-1."""

    value: float
    low: float
    high: float


def wilson(hits: int, trials: int, z: float = 1.959963984540054) -> Share:
    """Return the share `hits / trials` with its score interval.

    Args:
        hits: Episodes that count.
        trials: All episodes, at least one.
        z: Quantile of the normal distribution; the default gives 95 % confidence.

    Raises:
        ValueError: If there is no trial.

    Source: Wilson, J. Am. Stat. Assoc. 22 (1927).
    """
    if trials < 1:
        raise ValueError("a share needs at least one trial")
    share, weight = hits / trials, z * z / trials
    centre = (share + weight / 2.0) / (1.0 + weight)
    half = z * np.sqrt(share * (1.0 - share) / trials + weight / (4.0 * trials)) / (1.0 + weight)
    # Rounding must not put the share of none or of all outside its own interval.
    low, high = min(share, max(0.0, centre - half)), max(share, min(1.0, centre + half))
    return Share(share, float(low), float(high))


class Metrics(TypedDict):
    """What a number of episodes come to: `low` and `high` are the ends of a share's interval."""

    episodes: int
    success: float
    success_low: float
    success_high: float
    reached: float
    within_5cm: float
    within_5cm_low: float
    within_5cm_high: float
    ik_failures_per_episode: float
    mean_deviation_m: float
    joint_jumps_per_episode: float
    mean_steps: float


def summarize(records: EpisodeRecords) -> Metrics:
    """Return the figures of method and README: shares in 0-1, distances in metres."""
    episodes = len(records.reached)
    success = wilson(int(records.success.sum()), episodes)
    within = wilson(int(records.within.sum()), episodes)
    return {
        "episodes": episodes,
        "success": success.value,
        "success_low": success.low,
        "success_high": success.high,
        "reached": float(records.reached.mean()),
        "within_5cm": within.value,
        "within_5cm_low": within.low,
        "within_5cm_high": within.high,
        "ik_failures_per_episode": float(records.failures.mean()),
        "mean_deviation_m": float(records.mean_deviation.mean()),
        "joint_jumps_per_episode": float(records.joint_jumps.mean()),
        "mean_steps": float(records.steps.mean()),
    }
