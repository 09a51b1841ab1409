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
    damping_gain: float = 0.02  # times the squared error, m^2, is added to the least damping


class Limits(NamedTuple):
    """Lower and upper limits of joint positions, shape (v,) each; infinite for none."""

    lower: Array
    upper: Array


class Scratch(NamedTuple):
    """Memory of a descent, allocated once for a whole batch."""

    frames: Frames  # frames of the chain at the current joint positions
    columns: Array  # columns of the Jacobian J, weighted, shape (v, 6)
    normal: Array  # Cholesky factor of `_solve_damped`, shape (6, 6)
    error: Array  # EE error e, linear, then angular and weighted, shape (6,)
    solved: Array  # y of `_solve_damped`, shape (6,)
    step: Array  # joint step within the limits, shape (v,)
    unbounded: Array  # joint step without limits, shape (v,)
    pull: Array  # joint step towards which the first step is damped, shape (v,)
    side: Array  # 1 or -1 for joints held at the upper or lower limit, 0 for free ones, shape (v,)
    released: Array  # joints that have been released from a limit, shape (v,)
    trial: Array  # joint positions of the current descent, shape (v,)
    seed: Array  # copy of the seed of a search, shape (v,)


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

    Each step solves a damped least-squares problem within the joint limits; the damping grows with
    the squared error (Sugihara, IEEE T-RO 2011). The first step is damped towards `scratch.pull`
    in place of zero: a redundant arm follows it in its null space. `scratch.pull` ends as zero.

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

    The step s minimizes |J s - e|^2 + damping |s - p|^2 within bounds, with the pull p. Free joints
    move by s = p + J' y; joints that would pass a bound are held there. When no further joint would
    pass a bound, the held joint that would move back farthest is released, each joint at most once,
    and the step is solved again.
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
    """Solve (J J' + damping) y = e - J p for y, for free joints; steps of held joints reduce e."""
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
        # The diagonal holds reciprocals, since it is only divided by.
        low[i, i] = 1.0 / math.sqrt(total)
    for i in range(6):
        for j in range(i):
            y[i] -= low[i, j] * y[j]
        y[i] *= low[i, i]
    for i in range(5, -1, -1):
        for j in range(i + 1, 6):
            y[i] -= low[j, i] * y[j]
        y[i] *= low[i, i]
