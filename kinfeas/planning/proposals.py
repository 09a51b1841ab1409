"""Base commands that robots try along an EE path, and the arm motions that these need."""

import math
from typing import NamedTuple

import numpy as np

from kinfeas.core.kernels import inlined, kernel, square
from kinfeas.core.pose_kernels import heading
from kinfeas.core.spatial import Array
from kinfeas.kinematics.descent import rotation_error
from kinfeas.kinematics.drive import within_speed, write_action_toward
from kinfeas.kinematics.forward import Chain, fill_columns, make_frames, place_chain, write_matrix

_DAMPING = 1e-4  # damping of arm motions, squared metres for a squared fraction of `step`
_BASE_DAMPING = 100.0  # damping of base motions, squared fractions for a squared metre or radian
_POSE = 6  # joints that an arm needs to reach all poses nearby


class Proposal(NamedTuple):
    """Predictions for m robots that try t base commands each."""

    base: Array  # x, y and yaw of the base afterwards, shape (m, t, 3), metres and radians
    motion: Array  # largest joint displacement as a fraction of `step`, shape (m, t)
    joints: Array  # predicted arm joints, shape (m, t, j)
    sensitivity: Array  # squared joint motion for 1 m or rad of the EE, summed over 6 axes, (m,)


@kernel
def propose(chain: Chain, base, joints, command, near, target, step, limits, seconds):
    """Return predictions for base commands, some of which are first moved towards the EE's motion.

    If the arm has fewer than six joints, they are also moved to where it leaves the least error.

    After a command the EE has an error e in the frame of the base. With the Jacobian J of the arm
    and its largest displacements D = diag(`step`), the arm moves by D s, where

        s = argmin |J D s - e|^2 + damping |s|^2 = C (C' C + damping)^-1 e,  C = (J D)'.

    Only e depends on the command. Without damping, |s|^2 of unit errors e along the six axes sums
    up to the `sensitivity`, trace (C' C + damping)^-1.

    Args:
        chain: From the base to the EE.
        base: World poses of the bases, shape (m, 7).
        joints: Arm joints, shape (m, j).
        command: Base commands, shape (m, t, a); those from index `near` on are changed in place.
        near: Number of commands of each robot that stay.
        target: World pose of the EE afterwards, shape (7,).
        step: Largest joint displacements, shape (j,), radians or metres.
        limits: Velocity limits of the base, m/s and rad/s.
        seconds: Time for which the commands hold.
    """
    m, t, size = command.shape
    dof = joints.shape[1]
    out = Proposal(np.empty((m, t, 3)), np.empty((m, t)), np.empty((m, t, dof)), np.empty(m))
    frames, scaled = make_frames(len(chain.tree.variable)), np.empty((dof, 6))
    low, error, toward, velocity = np.empty((6, 6)), np.empty(6), np.empty(size), np.empty(2)
    moved, gain, normal = np.empty((3, 6)), np.empty((3, 6)), np.empty((3, 3))
    short = dof < _POSE
    orientation, turned = np.empty((3, 3)), np.empty((3, 3))
    write_matrix(target, orientation)
    for i in range(m):
        place_chain(chain, joints[i], frames)
        _write_scaled(chain, frames, step, scaled)
        out.sensitivity[i] = _factorize(scaled, low)
        yaw, position = heading(base[i]), frames.position
        if short:
            _write_gain(position, low, size, moved, gain, normal)
        _write_velocity(base[i], yaw, position, target, seconds, velocity)
        write_action_toward(base[i], velocity, limits, seconds, toward)
        for n in range(t):
            action, new = command[i, n], out.base[i, n]
            if n >= near:
                for k in range(size):
                    action[k] = min(max(action[k] + toward[k], -1.0), 1.0)
            for correction in range(2 if short and n >= near else 1):
                if correction:
                    _correct(gain, error, new[2] - yaw, limits, seconds, action)
                _drive(base[i], yaw, action, limits, seconds, new)
                # The error e. In a function of its own, its sums would be regrouped in another way.
                cosine, sine = math.cos(new[2]), math.sin(new[2])
                dx, dy = target[0] - new[0], target[1] - new[1]
                error[0] = cosine * dx + sine * dy - position[0]
                error[1] = cosine * dy - sine * dx - position[1]
                error[2] = target[2] - base[i, 2] - position[2]
                for k in range(3):
                    turned[0, k] = cosine * orientation[0, k] + sine * orientation[1, k]
                    turned[1, k] = cosine * orientation[1, k] - sine * orientation[0, k]
                    turned[2, k] = orientation[2, k]
                rotation_error(turned, frames.rotation, error)
            _solve(low, error)
            out.motion[i, n] = _move_arm(scaled, error, step, joints[i], out.joints[i, n])
    return out


@inlined
def _write_scaled(chain, frames, step, out):
    """Write C = (J D)', shape (j, 6)."""
    fill_columns(chain.tree, frames, out)
    for j in range(len(out)):
        for k in range(6):
            out[j, k] *= step[j]


@inlined
def _write_velocity(base, yaw, position, target, seconds, out):
    """Write the base velocity that brings the EE to the target's x and y with the arm at rest."""
    cosine, sine = math.cos(yaw), math.sin(yaw)
    out[0] = target[0] - base[0] - cosine * position[0] + sine * position[1]
    out[1] = target[1] - base[1] - sine * position[0] - cosine * position[1]
    for k in range(2):
        out[k] /= seconds


@inlined
def _write_gain(position, low, size, moved, gain, normal):
    """Write the base displacements for 1 m or rad of the error e, shape (3, 6).

    With B = -de / d(x, y, yaw) and A = C' C + damping they are (B' A^-1 B + damping)^-1 B' A^-1.
    """
    moved[:] = 0.0
    moved[0, 0], moved[1, 1] = 1.0, 1.0
    moved[2, 0], moved[2, 1], moved[2, 5] = -position[1], position[0], 1.0
    if size == 2:
        moved[1, 1] = 0.0
    for i in range(3):
        for k in range(6):
            gain[i, k] = moved[i, k]
        _solve(low, gain[i])
    for i in range(3):
        for k in range(3):
            normal[i, k] = _BASE_DAMPING if i == k else 0.0
            for j in range(6):
                normal[i, k] += moved[i, j] * gain[k, j]
    # Gauss-Jordan elimination of a positive definite matrix.
    for i in range(3):
        pivot = normal[i, i]
        for j in range(3):
            normal[i, j] /= pivot
        for j in range(6):
            gain[i, j] /= pivot
        for k in range(3):
            factor = normal[k, i]
            if k != i:
                for j in range(3):
                    normal[k, j] -= factor * normal[i, j]
                for j in range(6):
                    gain[k, j] -= factor * gain[i, j]


@inlined
def _correct(gain, error, turn, limits, seconds, action):
    """Change a command by the base displacement `gain` * `error`, in the base frame at its end."""
    x, y, angle = 0.0, 0.0, 0.0
    for k in range(6):
        x += gain[0, k] * error[k]
        y += gain[1, k] * error[k]
        angle += gain[2, k] * error[k]
    cosine, sine = math.cos(turn), math.sin(turn)
    if len(action) == 3:
        action[0] += (cosine * x - sine * y) / (limits[0] * seconds)
        action[1] += (sine * x + cosine * y) / (limits[0] * seconds)
    else:
        action[0] += x / (limits[0] * seconds)
    action[-1] += angle / (limits[1] * seconds)
    for k in range(len(action)):
        action[k] = min(max(action[k], -1.0), 1.0)


@inlined
def _move_arm(scaled, solved, step, joints, out):
    """Write joints moved by D s, s = C `solved`; return the largest |s|."""
    largest = 0.0
    for j in range(len(joints)):
        part = 0.0
        for k in range(6):
            part += scaled[j, k] * solved[k]
        out[j] = joints[j] + part * step[j]
        largest = max(largest, abs(part))
    return largest


@inlined
def _drive(base, yaw, command, limits, seconds, out):
    """Write x, y and yaw of a base after a command, along the chord of its arc."""
    ahead, turn, left = command[0] * limits[0], command[-1] * limits[1] * seconds, 0.0
    angle = yaw
    if len(command) == 2:
        angle += 0.5 * turn
    else:
        ahead, left = within_speed(ahead, command[1] * limits[0], limits[0])
    cosine, sine = math.cos(angle), math.sin(angle)
    out[0] = base[0] + seconds * (cosine * ahead - sine * left)
    out[1] = base[1] + seconds * (sine * ahead + cosine * left)
    out[2] = yaw + turn


@inlined
def _factorize(scaled, low):
    """Write L of C' C + damping = L L', shape (6, 6); return trace (C' C + damping)^-1."""
    for i in range(6):
        for k in range(i + 1):
            total = _DAMPING if i == k else 0.0
            for j in range(len(scaled)):
                total += scaled[j, i] * scaled[j, k]
            for j in range(k):
                total -= low[i, j] * low[k, j]
            low[i, k] = math.sqrt(total) if i == k else total / low[k, k]
    trace = 0.0
    for k in range(6):  # columns of the factor's inverse, in the upper triangle
        for i in range(k, 6):
            total = 1.0 if i == k else 0.0
            for j in range(k, i):
                total -= low[i, j] * (low[k, j] if j > k else 1.0 / low[k, k])
            value = total / low[i, i]
            if i > k:
                low[k, i] = value
            trace += square(value)
    return trace


@inlined
def _solve(low, error):
    """Solve L L' x = e in place."""
    for i in range(6):
        for j in range(i):
            error[i] -= low[i, j] * error[j]
        error[i] /= low[i, i]
    for i in range(5, -1, -1):
        for j in range(i + 1, 6):
            error[i] -= low[j, i] * error[j]
        error[i] /= low[i, i]
