"""One descent of IK: damped least squares with an active set of joint limits."""

import math
from typing import NamedTuple

import numpy as np

from kinfeas.core.kernels import copy_row, inlined, kernel, square
from kinfeas.core.spatial import Array
from kinfeas.kinematics.forward import Chain, Frames, fill_columns, make_frames, place_chain


class Descent(NamedTuple):
    """Options of a descent."""

    position_tolerance: float  # position error at which it ends, metres
    rotation_tolerance: float  # rotation error at which it ends, radians
    rotation_weight: float  # metres equivalent to one radian of error
    max_iterations: int  # largest number of steps
    stall_steps: int = 3  # steps without progress after which it ends
    damping_floor: float = 1e-6  # least damping, m^2
    damping_gain: float = 0.02  # factor of the squared error, m^2, that is added to it


class Limits(NamedTuple):
    """Lower and upper limits of joint positions, shape (v,) each; infinite for none."""

    lower: Array
    upper: Array


class Scratch(NamedTuple):
    """Memory of a descent, allocated once for a whole batch."""

    frames: Frames
    columns: Array
    normal: Array
    error: Array
    solved: Array
    step: Array
    unbounded: Array
    pull: Array
    side: Array
    released: Array
    trial: Array
    seed: Array


@kernel
def make_scratch(joints, variables):
    """Return scratch memory for a chain of `joints` joints and an arm of `variables` joints."""
    return Scratch(
        make_frames(joints), np.empty((variables, 6)), np.empty((6, 6)), np.empty(6), np.empty(6),
        np.empty(variables), np.empty(variables), np.zeros(variables),
        np.empty(variables, dtype=np.intp), np.empty(variables, dtype=np.bool_),
        np.empty(variables), np.empty(variables),
    )  # fmt: skip


@inlined
def descend(chain: Chain, options: Descent, limits: Limits, target, q, scratch: Scratch):
    """Move `q` towards the target; return the remaining position and rotation error, m and rad.

    Each step is damped by the squared error (Sugihara, IEEE T-RO 2011) and solves the damped
    least-squares problem within the joint limits. The first step is damped towards `scratch.pull`,
    a motion in the null space; `scratch.pull` is zero afterwards.

    Args:
        chain: From base to EE, driven by v variables.
        options: Tolerances, weight and largest number of steps.
        limits: Joint limits.
        target: EE orientation in the base frame, shape (3, 3), and position, (3,), metres.
        q: First joint positions, within the limits; receives the last ones, shape (v,).
        scratch: Memory of `make_scratch`; its frames are those of `q`, before and after.
    """
    stalled, best = 0, np.inf
    metres, radians = np.inf, np.inf
    for iteration in range(options.max_iterations + 1):
        metres, radians = measure(target, scratch)
        if metres <= options.position_tolerance and radians <= options.rotation_tolerance:
            break
        cost = square(metres) + square(options.rotation_weight * radians)
        stalled = 0 if cost < 0.95 * best else stalled + 1
        best = min(best, cost)
        # The errors returned are those of the last `q`.
        if stalled > options.stall_steps or iteration == options.max_iterations:
            break
        fill_columns(chain.tree, scratch.frames, scratch.columns)
        _weigh(options.rotation_weight, scratch)
        damping = options.damping_floor + options.damping_gain * cost
        _step_within_limits(limits, q, damping, scratch)
        for j in range(len(q)):
            q[j] += scratch.step[j]
        place_chain(chain, q, scratch.frames)
        scratch.pull[:] = 0.0
    scratch.pull[:] = 0.0
    return metres, radians


@inlined
def _weigh(weight, scratch):
    for i in range(3, 6):
        scratch.error[i] *= weight
        for j in range(len(scratch.columns)):
            scratch.columns[j, i] *= weight


@inlined
def measure(target, scratch):
    """Write the error of the EE in `scratch.frames`; return its norms, metres and radians."""
    squared = 0.0
    for i in range(3):
        scratch.error[i] = target[1][i] - scratch.frames.position[i]
        squared += square(scratch.error[i])
    angle = rotation_error(target[0], scratch.frames.rotation, scratch.error)
    return math.sqrt(squared), angle


@inlined
def rotation_error(target, current, error):
    """Write the rotation vector from `current` to `target` to error[3:]; return its norm."""
    trace = 0.0
    for i in range(3):
        for k in range(3):
            trace += target[i, k] * current[i, k]
    x, y, z = 0.0, 0.0, 0.0
    for k in range(3):
        x += target[2, k] * current[1, k] - target[1, k] * current[2, k]
        y += target[0, k] * current[2, k] - target[2, k] * current[0, k]
        z += target[1, k] * current[0, k] - target[0, k] * current[1, k]
    sine = 0.5 * math.sqrt(x * x + y * y + z * z)
    cosine = 0.5 * (trace - 1.0)
    angle = math.atan2(sine, cosine)
    if sine > 1e-9:
        scale = 0.5 * angle / sine
        error[3], error[4], error[5] = x * scale, y * scale, z * scale
    elif cosine > 0.0:
        error[3], error[4], error[5] = 0.5 * x, 0.5 * y, 0.5 * z
    else:
        _half_turn(target, current, error)
    return angle


@inlined
def _half_turn(target, current, error):
    """Write a half turn about the axis n of R = 2 n n' - 1, where the sine is zero."""
    largest, column = -1.0, 0
    for i in range(3):
        diagonal = 0.0
        for k in range(3):
            diagonal += target[i, k] * current[i, k]
        if diagonal > largest:
            largest, column = diagonal, i
    norm = 0.0
    for i in range(3):
        entry = 0.0
        for k in range(3):
            entry += target[i, k] * current[column, k]
        error[3 + i] = entry + (1.0 if i == column else 0.0)
        norm += square(error[3 + i])
    scale = math.pi / math.sqrt(norm)
    for i in range(3):
        error[3 + i] *= scale


@inlined
def _step_within_limits(limits, q, damping, scratch):
    """Write the damped least-squares step that keeps `q` within its limits.

    Of min |J s - e|^2 + damping |s - p|^2 within bounds, with the pull p, the free joints' part is
    s = p + J' y. A joint that would pass a bound is held there. When no other does, a held joint
    that would move back within its bounds is released, each joint once, and the rest is solved
    again.
    """
    step, unbounded = scratch.step, scratch.unbounded
    side, released = scratch.side, scratch.released
    side[:], released[:] = 0, False
    for _ in range(3 * len(q)):
        _solve_damped(scratch, damping)
        blocked = False
        for j in range(len(q)):
            unbounded[j] = scratch.pull[j]
            for i in range(6):
                unbounded[j] += scratch.columns[j, i] * scratch.solved[i]
            if side[j] == 0:
                step[j] = unbounded[j]
                if q[j] + unbounded[j] > limits.upper[j]:
                    step[j], side[j], blocked = limits.upper[j] - q[j], 1, True
                elif q[j] + unbounded[j] < limits.lower[j]:
                    step[j], side[j], blocked = limits.lower[j] - q[j], -1, True
        if not blocked and not _release(scratch):
            return


@inlined
def _release(scratch):
    """Release the held joint that would move back farthest; return whether there is one."""
    worst, choice = 0.0, -1
    for j in range(len(scratch.side)):
        inward = scratch.side[j] * (scratch.step[j] - scratch.unbounded[j])
        if scratch.side[j] != 0 and not scratch.released[j] and inward > worst:
            worst, choice = inward, j
    if choice >= 0:
        scratch.side[choice], scratch.released[choice] = 0, True
    return choice >= 0


@inlined
def _solve_damped(scratch, damping):
    """Write y of (J J' + damping) y = e for free joints; pull and held joints reduce e."""
    columns, low, y = scratch.columns, scratch.normal, scratch.solved
    copy_row(scratch.error, y)
    low[:] = 0.0
    for j in range(len(columns)):
        if scratch.side[j] == 0:
            for i in range(6):
                y[i] -= columns[j, i] * scratch.pull[j]
                for k in range(i + 1):
                    low[i, k] += columns[j, i] * columns[j, k]
        else:
            for i in range(6):
                y[i] -= columns[j, i] * scratch.step[j]
    for i in range(6):
        for k in range(i):
            total = low[i, k]
            for j in range(k):
                total -= low[i, j] * low[k, j]
            low[i, k] = total * low[k, k]
        total = low[i, i] + damping
        for j in range(i):
            total -= low[i, j] * low[i, j]
        # The diagonal holds the inverse, since it only divides.
        low[i, i] = 1.0 / math.sqrt(total)
    for i in range(6):
        for j in range(i):
            y[i] -= low[i, j] * y[j]
        y[i] *= low[i, i]
    for i in range(5, -1, -1):
        for j in range(i + 1, 6):
            y[i] -= low[j, i] * y[j]
        y[i] *= low[i, i]
