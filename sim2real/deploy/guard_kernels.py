"""The kernel of the safety filter: joint targets within the limits, for one robot."""

from kinfeas.core.kernel_cache import compiled
from kinfeas.core.pose_kernels import wrapped


@compiled(
    ["void(f8[:], f8[:], f8[:], f8[:], b1[:], f8[:], f8[:], f8, f8[:], f8[:], f8[:])"],
    "(j),(j),(j),(j),(j),(j),(j),()->(j),(),(j)",
)
def limited_targets(
    targets, before, measured, speed, continuous, lower, upper, dt, out, farthest, lag
):
    """Joint targets, from the last ones towards the next, that joints reach in `dt` seconds.

    Joints are in radians or metres. `farthest` is the longest displacement of a joint to its next
    target, `lag` the seconds that each needs to its last one.
    """
    farthest[0], periods = 0.0, 1.0
    for j in range(len(out)):
        change, behind = targets[j] - before[j], before[j] - measured[j]
        if continuous[j]:
            change, behind = wrapped(change), wrapped(behind)
        out[j], lag[j] = change, abs(behind) / speed[j]
        farthest[0] = max(farthest[0], abs(change))
        periods = max(periods, abs(change) / (speed[j] * dt))
    for j in range(len(out)):
        target = before[j] + out[j] / periods
        target = wrapped(target) if continuous[j] else target
        # A joint that starts beyond a limit must not jump to it.
        out[j] = min(max(target, min(lower[j], before[j])), max(upper[j], before[j]))
