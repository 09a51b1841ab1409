"""Half-spaces of base velocities, which the obstacle filter allows, and projection into them."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinfeas.core.kernels import compiled, inlined, kernel, square
from kinfeas.core.pose_kernels import clipped
from kinfeas.core.spatial import Array

LEVER = 0.05
"""Radius in metres by which rotations are compared with translations. It is small, so that a base
turns aside before it leaves the path of its arm."""

_RESTORE = 0.5  # seconds in which a base restores most of a distance that is too small
_SLACK = 1e-6  # velocity in m/s by which rounding may exceed a limit

_ROUNDS = 100
"""Largest number of times that a half-space becomes active; most points take fewer than five."""

_FRACTIONS = (1.0, 0.5, 0.0)
"""Fractions of negative offsets that are tried, until there is a point in all half-spaces."""

_PARALLEL = 1e-9  # squared sine of the angle to active normals below which one depends on them


@dataclass(frozen=True)
class VelocityConstraints:
    """Linear constraints on base velocities u of n robots: `normal @ u <= limit`."""

    full: Array  # velocity of a full command, shape (a,), m/s; rotation at `LEVER`
    normal: Array  # fraction of each velocity that approaches k obstacles, (n, k, a)
    limit: Array  # velocities, (n, k), m/s; inf without obstacle, negative to move away

    def of(self, rows: NDArray[np.intp]) -> "VelocityConstraints":
        """Return the constraints of some rows."""
        return VelocityConstraints(self.full, self.normal[rows], self.limit[rows])

    def hold(self, action: Array) -> Array:
        """Return the commands nearest to `action`, shape (n, t, a), that satisfy the constraints.

        Commands that satisfy them stay bit-identical. No row depends on the others.
        """
        held = np.array(action, dtype=np.float64, order="C")
        hold(held, self.full, self.normal, self.limit)
        return held


@compiled(["void(f8[:,:], f8[:,:], f8[:], f8[:,:])"], "(k,p),(k,p),(a)->(k,a)")
def approach(point, normal, like, out):
    """Fraction of each velocity that approaches each obstacle."""
    last = len(like) - 1
    for k in range(len(point)):
        for i in range(last):
            out[k, i] = normal[k, i]
        out[k, last] = (normal[k, 1] * point[k, 0] - normal[k, 0] * point[k, 1]) / LEVER


@compiled(["void(f8[:], f8[:], f8[:], f8[:])"], "(k),(k),(r)->(k)")
def allowed(distance, closing_speed, rules, out):
    """Velocity at which each obstacle may be approached.

    `rules` are the distance to keep, metres, the braking, m/s^2, and the least time in which a base
    may use up the distance beyond it, seconds.
    """
    least, braking, seconds = rules
    for k in range(len(distance)):
        excess = distance[k] - least
        ahead = max(excess, 0.0)
        # A turn leads a little off the straight line, so the base restores the distance.
        out[k] = min(math.sqrt(braking * ahead), ahead / seconds) + min(excess, 0.0) / _RESTORE
        out[k] -= max(closing_speed[k], 0.0)  # receding obstacles may turn back


@kernel
def hold(actions, full, normal, limit):
    """Change actions, shape (n, t, a), that exceed a limit of their row."""
    velocity = np.empty(len(full))
    for row in range(len(actions)):
        for action in actions[row]:
            for i in range(len(full)):
                velocity[i] = clipped(action[i])
            velocity[:-1] /= max(_speed(velocity), 1.0)
            velocity *= full
            if project(velocity, normal[row], limit[row], _SLACK):
                velocity /= full
                # A detour that is faster than the base can drive slows the whole command down.
                action[:] = velocity / max(_speed(velocity), 1.0)


@inlined
def _speed(command):
    """Return the length of a command without its rotation."""
    squared = 0.0
    for i in range(len(command) - 1):
        squared += square(command[i])
    return math.sqrt(squared)


@kernel
def project(point, normals, offsets, slack):
    """Move a point (a,) to the nearest one in all half-spaces; return whether it was outside.

    The half-spaces are `normals @ point <= offsets`, shapes (k, a) and (k,); `slack` is allowed,
    above 0. Where no point is in all of them, negative offsets are raised up to 0; a point that
    is still outside moves to the origin, which is in all half-spaces then.
    """
    if _worst(point, normals, offsets)[1] <= slack:
        return False
    start, lowest = point.copy(), min(offsets.min(), 0.0)
    for fraction in _FRACTIONS:
        point[:] = start
        if _move(point, normals, np.maximum(offsets, fraction * lowest), slack):
            return True
        if lowest == 0.0:
            break
    point[:] = 0.0
    return True


@kernel
def _move(point, normals, offsets, slack):
    """Move a point (a,) to the nearest one of all half-spaces; return whether there is one.

    Goldfarb and Idnani, "A numerically stable dual method for solving strictly convex quadratic
    programs", 1983: the half-space that is exceeded most becomes active; active ones whose border
    then no longer pushes the point are dropped.
    """
    count = 0
    borders, pushes = np.empty(len(point), dtype=np.int64), np.empty(len(point))
    for _ in range(_ROUNDS):
        worst, excess = _worst(point, normals, offsets)
        if excess <= slack:
            return True
        normal, push = normals[worst], 0.0
        while True:
            weights = _weights(normals, borders[:count], normal)
            ahead = normal - normals[borders[:count]].T @ weights
            squared = _dot(ahead, ahead)
            free = count < len(point) and squared > _PARALLEL * _dot(normal, normal)
            step, last = (excess / squared if free else np.inf), -1
            for i in range(count):
                if weights[i] > 0.0 and pushes[i] < step * weights[i]:
                    step, last = pushes[i] / weights[i], i
            if step == np.inf:
                return False
            if free:
                point -= step * ahead
                excess -= step * squared
            pushes[:count] -= step * weights
            push += step
            if last < 0:
                borders[count], pushes[count] = worst, push
                count += 1
                break
            count -= 1
            borders[last:count] = borders[last + 1 : count + 1].copy()
            pushes[last:count] = pushes[last + 1 : count + 1].copy()
    return False


@kernel
def _weights(normals, borders, normal):
    """Return the weights, (b,), with which b borders' normals best approximate a normal, (a,)."""
    active = normals[borders]
    return np.linalg.solve(active @ active.T, active @ normal)


@inlined
def _worst(point, normals, offsets):
    """Return the half-space that a point exceeds most, and by how much."""
    worst, excess = 0, -np.inf
    for i in range(len(offsets)):
        over = _dot(normals[i], point) - offsets[i]
        if over > excess:
            worst, excess = i, over
    return worst, excess


@inlined
def _dot(a, b):
    total = 0.0
    for i in range(len(a)):
        total += a[i] * b[i]
    return total
