"""Kernels of the safety filter, for one robot: commands within the limits."""

from kinfeas.core.kernel_cache import compiled
from kinfeas.core.pose_kernels import inlined, wrapped
from kinfeas.kinematics.drive import within_speed


@inlined
def _shortened(x, y, turn, linear, angular):
    x, y = within_speed(x, y, linear)
    return x, y, min(max(turn, -angular), angular)


@compiled(["void(f8[:], f8[:], f8[:], f8, f8[:])"], "(v),(v),(l),()->(v)")
def limited_velocity(velocity, before, limits, dt, out):
    """Velocity nearest to `velocity`, `dt` seconds after another one.

    Velocities are forward, left and rotation, m/s and rad/s. `limits` are those of speed and
    rotation, and of the change of each in a second.
    """
    x, y, turn = _shortened(velocity[0], velocity[1], velocity[2], limits[0], limits[1])
    x, y, turn = x - before[0], y - before[1], turn - before[2]
    x, y, turn = _shortened(x, y, turn, limits[2] * dt, limits[3] * dt)
    out[0], out[1], out[2] = before[0] + x, before[1] + y, before[2] + turn


@compiled(
    ["void(f8[:], f8[:], f8[:], f8[:], b1[:], f8[:], f8[:], f8, f8[:], f8[:], f8[:])"],
    "(j),(j),(j),(j),(j),(j),(j),()->(j),(),(j)",
)
def limited_targets(
    targets, before, measured, speed, continuous, lower, upper, dt, out, farthest, lag
):
    """Joint targets between the last ones and `targets` that joints reach in `dt` seconds.

    Joints are in radians or metres. `farthest` is the longest distance of a joint to its target,
    `lag` the seconds that each needs to its last one.
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
