"""Metrics of episodes: success with confidence intervals, IK failures, deviations, joint jumps."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, TypedDict

import numpy as np
from numpy.typing import NDArray

from kinfeas.core.spatial import Array

GOAL_METRES, GOAL_RADIANS = 0.025, float(np.deg2rad(12.0))
"""Tolerances of a goal, which must be reached on a feasible step."""

WITHIN = 0.05
"""Largest deviation of the EE, metres, in an episode that counts as within 5 cm."""


@dataclass(frozen=True)
class EpisodeRecords:
    """Records of n episodes.

    Attributes:
        reached: Whether the goal, the end of the last sub-goal, was reached, shape (n,).
        failures: Steps without an IK solution, shape (n,).
        max_deviation: Largest distance of the EE from the desired position, metres, shape (n,).
        mean_deviation: Mean of that distance over the episode, metres, shape (n,).
        final_distance: Distance of the EE from the goal at the end, metres, shape (n,); infinite
            if the last sub-goal did not begin.
        joint_jumps: Steps in which a joint moved faster than its limit, shape (n,).
        steps: Length of the episode, shape (n,).
        task_done: Whether the objects ended as the task asks for, or the goal was reached if the
            task has no objects, shape (n,); None if the backend does not measure it.
        base_collisions: Collisions of the base, shape (n,); None likewise.
        arm_collisions: Collisions of the arm, shape (n,); None likewise.
        rms_deviation: Root mean square of the deviation, metres, shape (n,), where the target is a
            stream.
        way: Length of the EE's true way, metres, shape (n,), likewise.
        planned_way: Length of the way that the stream asks for, metres, shape (n,), likewise.
    """

    reached: NDArray[np.bool_]
    failures: NDArray[np.intp]
    max_deviation: Array
    mean_deviation: Array
    final_distance: Array
    joint_jumps: NDArray[np.intp]
    steps: NDArray[np.intp]
    task_done: NDArray[np.bool_] | None = None
    base_collisions: NDArray[np.intp] | None = None
    arm_collisions: NDArray[np.intp] | None = None
    rms_deviation: Array | None = None
    way: Array | None = None
    planned_way: Array | None = None

    @property
    def success(self) -> NDArray[np.bool_]:
        """Whether the goal was reached without an IK failure, shape (n,)."""
        return self.reached & (self.failures == 0)

    @property
    def within(self) -> NDArray[np.bool_]:
        """Whether deviation and final distance were at most `WITHIN`, shape (n,)."""
        return (self.max_deviation <= WITHIN) & (self.final_distance <= WITHIN)


def join(parts: Sequence[EpisodeRecords]) -> EpisodeRecords:
    """Return the episodes of all parts, one after the other; at least one part."""
    joined: dict[str, Any] = {}
    for entry in fields(EpisodeRecords):
        values = [getattr(part, entry.name) for part in parts]
        known = [one for one in values if one is not None]
        if known and len(known) < len(parts):  # a part without solids has no collisions
            values = [
                np.zeros(len(part.reached), known[0].dtype) if one is None else one
                for part, one in zip(parts, values, strict=True)
            ]
        joined[entry.name] = np.concatenate(values) if known else None
    return EpisodeRecords(**joined)


@dataclass(frozen=True)
class Proportion:
    """A share of episodes with its 95 % Wilson interval, all in 0-1."""

    value: float
    low: float
    high: float


def wilson(hits: int, trials: int) -> Proportion:
    """Return the share `hits / trials` with its 95 % score interval; at least one trial.

    Source: Wilson, J. Am. Stat. Assoc. 22 (1927).
    """
    z = 1.959963984540054  # quantile of the normal distribution
    share, weight = hits / trials, z * z / trials
    centre = (share + weight / 2.0) / (1.0 + weight)
    half = z * np.sqrt(share * (1.0 - share) / trials + weight / (4.0 * trials)) / (1.0 + weight)
    # Rounding must not put a share of 0 or 1 outside its interval.
    low, high = min(share, max(0.0, centre - half)), max(share, min(1.0, centre + half))
    return Proportion(share, float(low), float(high))


class Metrics(TypedDict):
    """Metrics of episodes; `low` and `high` are the ends of the interval of a share.

    Task success and collisions are null if the backend does not measure them. The last five are
    those of streams of targets: `smooth` is the share of episodes without IK failure and joint
    jump, `speed_share` the mean speed of the EE as a share of the asked one.
    """

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
    task_success: float | None
    task_success_low: float | None
    task_success_high: float | None
    base_collisions: float | None
    arm_collisions: float | None
    collision_free_rate: float | None
    smooth: float | None
    smooth_low: float | None
    smooth_high: float | None
    speed_share: float | None
    rms_deviation_m: float | None


def summarize(records: EpisodeRecords) -> Metrics:
    """Return the metrics of episodes: shares in 0-1, distances in metres."""
    episodes = len(records.reached)
    success = wilson(int(records.success.sum()), episodes)
    within = wilson(int(records.within.sum()), episodes)
    done, base, arm = records.task_done, records.base_collisions, records.arm_collisions
    task = None if done is None else wilson(int(done.sum()), episodes)
    smooth = speed = rms = None
    if (
        records.way is not None
        and records.planned_way is not None
        and records.rms_deviation is not None
    ):
        smooth = wilson(int((records.success & (records.joint_jumps == 0)).sum()), episodes)
        speed = float(records.way.sum() / records.planned_way.sum())
        rms = float(np.sqrt(np.average(records.rms_deviation**2, weights=records.steps)))
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
        "task_success": task.value if task else None,
        "task_success_low": task.low if task else None,
        "task_success_high": task.high if task else None,
        "base_collisions": None if base is None else float(base.mean()),
        "arm_collisions": None if arm is None else float(arm.mean()),
        "collision_free_rate": (
            None if base is None or arm is None else float(np.mean(base + arm == 0))
        ),
        "smooth": smooth.value if smooth else None,
        "smooth_low": smooth.low if smooth else None,
        "smooth_high": smooth.high if smooth else None,
        "speed_share": speed,
        "rms_deviation_m": rms,
    }
