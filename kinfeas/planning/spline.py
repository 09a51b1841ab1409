"""Paths as uniform cubic B-splines, and motions along them with smooth ramps of their speed."""

import math

import numpy as np

from kinfeas.core.kernels import compiled, exact, exact_inner
from kinfeas.core.motion import WAYPOINTS
from kinfeas.core.pose_kernels import write_reached, write_twist

POINTS = WAYPOINTS  # control points of a path


@exact_inner
def squared_length(a, b):
    """Return the squared distance of two points, shape (3,) each, m^2."""
    x, y, z = a[0] - b[0], a[1] - b[1], a[2] - b[2]
    return x * x + y * y + z * z


@exact
def fractions_ahead(points, fraction, distances, out):
    """Write the path fractions `distances` metres ahead, (n,) and (d,) -> (n, d), at most 1."""
    lengths, ends = np.empty(POINTS - 1), np.empty((2, 3))
    for i in range(len(fraction)):
        t = fraction[i] * (POINTS - 1)
        measured = first = min(int(t), POINTS - 2)
        write_position(points[i], first, ends[first % 2])
        for d in range(len(distances)):
            remaining, k, done = distances[d], first, t - first
            while k < POINTS - 1:
                if k == measured:
                    write_position(points[i], k + 1, ends[(k + 1) % 2])
                    lengths[k] = math.sqrt(squared_length(ends[0], ends[1]))
                    measured += 1
                if remaining <= lengths[k] * (1.0 - done):
                    done += remaining / max(lengths[k], 1e-12)
                    break
                remaining -= lengths[k] * (1.0 - done)
                k, done = k + 1, 0.0
            out[i, d] = min((k + min(done, 1.0)) / (POINTS - 1), 1.0)


@exact_inner
def write_position(points, t, out):
    """Write the first columns of a path, as its position, `t` control points from its beginning."""
    k = min(int(t), POINTS - 2)
    u = t - k
    v = 1.0 - u
    p, q = v * v * v, u * u * u
    for i in range(len(out)):
        b, c = points[k, i], points[k + 1, i]
        a = points[k - 1, i] if k > 0 else 2.0 * b - c
        d = points[k + 2, i] if k < POINTS - 2 else 2.0 * c - b
        out[i] = (
            p * a + (4.0 - 6.0 * u * u + 3.0 * q) * b + (4.0 - 6.0 * v * v + 3.0 * p) * c + q * d
        ) / 6.0


@compiled(["void(f8[:, :], f8, f8[:])"], "(k,d),()->(d)")
def position_at(points, fraction, out):
    """Position of a path, a uniform cubic B-spline, at a fraction in [0, 1]."""
    write_position(points, fraction * (POINTS - 1), out)


@compiled(["void(f8[:, :], f8, f8, f8[:], f8[:], f8[:])"], "(k,p),(),(),(p),(p)->(p)")
def pose_at(points, fraction, rate, origin, target, out):
    """Pose at a fraction of a path that was planned to end at `origin` and is bent to `target`.

    With a rate of 0 there is no path: the motion is straight from `origin` to `target`.
    """
    displacement = np.empty(6)
    write_twist(origin, target, 1.0, displacement)
    if rate == 0.0:
        write_reached(origin, displacement, fraction, out)
        return
    write_position(points, fraction * (POINTS - 1), out)
    x, y, z, w = out[3], out[4], out[5], out[6]
    out[3:] /= math.sqrt(x * x + y * y + z * z + w * w)
    write_reached(out, displacement, fraction, out)


@exact_inner
def phases(first, rate, ramp):
    """Return the seconds in which the rate of a motion changes, is constant, and falls to rest."""
    rate = max(rate, 1e-9)
    rise, fall = 0.0 if first == rate else ramp, min(ramp, 2.0 / rate)
    cruise = (1.0 - 0.5 * rise * (first + rate) - 0.5 * fall * rate) / rate
    return rise, max(cruise, 0.0), fall


@compiled(["void(f8, f8, f8, f8[:])"], "(),(),()->()")
def duration(first, rate, ramp, out):
    """Seconds that a motion takes: its rate rises or falls from the first one, in the end to 0."""
    rise, cruise, fall = phases(first, rate, ramp)
    out[0] = rise + cruise + fall


@exact_inner
def _ramped(u):
    """Return the integral of the quintic step `10 u^3 - 15 u^4 + 6 u^5` from 0 to u in [0, 1]."""
    return u * u * u * u * (2.5 + u * (u - 3.0))


@compiled(["void(f8, f8, f8, f8, f8, f8[:])"], "(),(),(),(),()->()")
def fraction_after(time, seconds, first, rate, ramp, out):
    """Fraction of its path that a motion has done after a time.

    With a rate of 0 it is that of a `minimum_jerk` motion of `seconds`.
    """
    if rate <= 0.0:
        s = time / seconds
        out[0] = s * s * s * (10.0 + s * (6.0 * s - 15.0))
        return
    rise, cruise, fall = phases(first, rate, ramp)
    fraction = 0.0
    if rise > 0.0:
        u = min(time / rise, 1.0)
        fraction = rise * (first * u + (rate - first) * _ramped(u))
    v = min(max((time - rise - cruise) / max(fall, 1e-9), 0.0), 1.0)
    fraction += rate * min(max(time - rise, 0.0), cruise)
    fraction += rate * fall * (v - _ramped(v))
    out[0] = min(fraction, 1.0)
