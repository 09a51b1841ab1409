"""Metrics of episodes: success with confidence intervals, IK failures, deviations, joint jumps."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, TypedDict, cast

import numpy as np
from numpy.typing import NDArray

from kinfeas.core.spatial import Array

GOAL_METRES, GOAL_RADIANS = 0.025, float(np.deg2rad(12.0))
"""Tolerances of a goal, which must be reached on a feasible step."""

WITHIN = 0.05
"""Largest deviation of the EE, metres, in an episode that counts as within 5 cm."""


@dataclass(frozen=True)
class EpisodeRecords:
    """Records of n episodes; values are None where the backend does not measure them."""

    reached: NDArray[np.bool_]  # whether the end of the last sub-goal was reached, shape (n,)
    failures: NDArray[np.intp]  # steps without an IK solution, shape (n,)
    max_deviation: Array  # largest distance of the EE from the desired position, metres, shape (n,)
    mean_deviation: Array  # mean of that distance over the episode, metres, shape (n,)
    # distance of the EE at the end from goal or stream, metres, (n,); inf before the last sub-goal
    final_distance: Array
    joint_jumps: NDArray[np.intp]  # steps with a joint commanded faster than its limit, shape (n,)
    steps: NDArray[np.intp]  # length of the episode, shape (n,)
    # whether objects meet the task's condition, or without objects the goal was reached, shape (n,)
    task_done: NDArray[np.bool_] | None = None
    base_collisions: NDArray[np.intp] | None = None  # collisions of the base, shape (n,)
    arm_collisions: NDArray[np.intp] | None = None  # collisions of the arm, shape (n,)
    # root mean square of the deviation, metres, shape (n,); this and the next two only for streams
    rms_deviation: Array | None = None
    path_length: Array | None = None  # length of the EE's true path, metres, shape (n,)
    target_path_length: Array | None = None  # length of the stream's path, metres, shape (n,)
    # as the deviations, but in the frame of the localisation, (n,); None if that has no errors
    max_tracking_error: Array | None = None
    mean_tracking_error: Array | None = None
    response_sums: Array | None = None  # sums for `lateness`, shape (n, 2), of robots with delay

    @property
    def success(self) -> NDArray[np.bool_]:
        """Whether the goal was reached without an IK failure, shape (n,)."""
        return self.reached & (self.failures == 0)

    @property
    def within(self) -> NDArray[np.bool_]:
        """Whether deviation and final distance were at most `WITHIN`, shape (n,)."""
        return (self.max_deviation <= WITHIN) & (self.final_distance <= WITHIN)

    @property
    def tracked(self) -> NDArray[np.bool_]:
        """Whether tracking error and final distance were at most `WITHIN`, shape (n,)."""
        largest = self.max_tracking_error
        if largest is None:
            return self.within
        return (largest <= WITHIN) & (self.final_distance <= WITHIN)


def join(parts: Sequence[EpisodeRecords]) -> EpisodeRecords:
    """Return the episodes of all parts, one after the other; at least one part."""
    joined: dict[str, Any] = {}
    for name in (field.name for field in fields(EpisodeRecords)):
        values = [getattr(part, name) for part in parts]
        example = next((array for array in values if array is not None), None)
        if example is not None:  # a part without solids has no collisions
            pairs = zip(parts, values, strict=True)
            shape = example.shape[1:]
            values = [
                np.zeros((len(part.reached), *shape), example.dtype) if value is None else value
                for part, value in pairs
            ]
        joined[name] = None if example is None else np.concatenate(values)
    return EpisodeRecords(**joined)


@dataclass(frozen=True)
class Proportion:
    """A fraction of episodes with its 95 % Wilson interval, all in 0-1."""

    value: float
    low: float
    high: float


def lateness(sums: Array) -> float | None:
    """Return the seconds by which bases are later than their response model predicts.

    Least-squares estimate from `Loop.response_sums`, shape (n, 2); None for bases at rest.
    """
    products, squares = sums.sum(axis=0).tolist()
    return products / squares if squares > 0.0 else None


def wilson(hits: int, trials: int) -> Proportion:
    """Return the fraction `hits / trials` with its 95 % score interval; at least one trial.

    Source: Wilson, J. Am. Stat. Assoc. 22 (1927).
    """
    z = 1.959963984540054  # quantile of the normal distribution
    rate, weight = hits / trials, z * z / trials
    centre = (rate + weight / 2.0) / (1.0 + weight)
    half = z * np.sqrt(rate * (1.0 - rate) / trials + weight / (4.0 * trials)) / (1.0 + weight)
    # Rounding must not put a fraction of 0 or 1 outside its interval.
    low, high = min(rate, max(0.0, centre - half)), max(rate, min(1.0, centre + half))
    return Proportion(rate, float(low), float(high))


class Metrics(TypedDict):
    """Metrics of episodes; `low` and `high` are the ends of the interval of a fraction.

    Deviations are the true ones in a simulation. Tracking errors leave out the errors of the
    localisation, which control cannot correct. Both are measured from the position desired one
    command latency of the response model ago; loops without a model therefore count the latency.
    `lateness_s` is a lower estimate of the seconds by which bases are later than their response
    model predicts; null for those without delay. Task success and collisions are null if the
    backend does not measure them. The last five are metrics of streams of targets: `smooth` is the
    fraction of episodes without IK failure and joint jump, `speed_share` the mean speed of the EE
    relative to the speed of the stream.
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
    tracked_5cm: float
    tracked_5cm_low: float
    tracked_5cm_high: float
    mean_tracking_error_m: float
    lateness_s: float | None
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
    """Return the metrics of episodes: fractions in 0-1, distances in metres."""
    base, arm = records.base_collisions, records.arm_collisions
    smooth = speed = rms = collision_free = None
    if base is not None and arm is not None:
        collision_free = base + arm == 0
    if (
        records.path_length is not None
        and records.target_path_length is not None
        and records.rms_deviation is not None
    ):
        smooth = records.success & (records.joint_jumps == 0)
        if target_length := float(records.target_path_length.sum()):
            speed = float(records.path_length.sum()) / target_length
        rms = float(np.sqrt(np.average(records.rms_deviation**2, weights=records.steps)))
    tracking = records.mean_tracking_error
    tracking = records.mean_deviation if tracking is None else tracking
    summary = {
        "episodes": len(records.reached),
        **_fraction("success", records.success),
        "reached": float(records.reached.mean()),
        **_fraction("within_5cm", records.within),
        "ik_failures_per_episode": float(records.failures.mean()),
        "mean_deviation_m": float(records.mean_deviation.mean()),
        **_fraction("tracked_5cm", records.tracked),
        "mean_tracking_error_m": float(tracking.mean()),
        "lateness_s": None if records.response_sums is None else lateness(records.response_sums),
        "joint_jumps_per_episode": float(records.joint_jumps.mean()),
        "mean_steps": float(records.steps.mean()),
        **_fraction("task_success", records.task_done),
        "base_collisions": None if base is None else float(base.mean()),
        "arm_collisions": None if arm is None else float(arm.mean()),
        "collision_free_rate": None if collision_free is None else float(collision_free.mean()),
        **_fraction("smooth", smooth),
        "speed_share": speed,
        "rms_deviation_m": rms,
    }
    return cast("Metrics", summary)


def _fraction(name: str, hits: NDArray[np.bool_] | None) -> dict[str, float | None]:
    if hits is None:
        return dict.fromkeys((name, f"{name}_low", f"{name}_high"))
    rate = wilson(int(hits.sum()), len(hits))
    return {name: rate.value, f"{name}_low": rate.low, f"{name}_high": rate.high}
