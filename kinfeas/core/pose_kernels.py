"""Compiled pose arithmetic behind `spatial`: generalized ufuncs, one pose at a time.

They take about 1 us a call; `scipy.spatial.transform.Rotation` takes 10 to 100 us. Quaternions are
xyzw; results have w >= 0 and unit length. The result of a row does not depend on the batch.
"""

import math

import numpy as np

from kinfeas.core.kernels import compiled, exact_inlined

IDENTITY = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


@exact_inlined
def product(ax, ay, az, aw, bx, by, bz, bw):
    """Return the unit quaternion of b followed by a, with w >= 0."""
    x = aw * bx + ax * bw + ay * bz - az * by
    y = aw * by - ax * bz + ay * bw + az * bx
    z = aw * bz + ax * by - ay * bx + az * bw
    w = aw * bw - ax * bx - ay * by - az * bz
    scale = 1.0 / math.sqrt(x * x + y * y + z * z + w * w)
    if w < 0.0:
        scale = -scale
    return x * scale, y * scale, z * scale, w * scale


@exact_inlined
def _rotated(x, y, z, w, vx, vy, vz):
    tx, ty, tz = 2.0 * (y * vz - z * vy), 2.0 * (z * vx - x * vz), 2.0 * (x * vy - y * vx)
    return (
        vx + w * tx + y * tz - z * ty,
        vy + w * ty + z * tx - x * tz,
        vz + w * tz + x * ty - y * tx,
    )


@compiled(["void(f8[:], f8[:], f8[:])"], "(p),(p)->(p)")
def compose(parent, child, out):
    """Pose `child`, which is relative to `parent`, in the frame of `parent`."""
    a, b = parent, child
    x, y, z = _rotated(a[3], a[4], a[5], a[6], b[0], b[1], b[2])
    quaternion = product(a[3], a[4], a[5], a[6], b[3], b[4], b[5], b[6])
    out[0], out[1], out[2] = a[0] + x, a[1] + y, a[2] + z
    out[3], out[4], out[5], out[6] = quaternion


@exact_inlined
def _write_relative(pose, frame, out):
    a, b = frame, pose
    x, y, z = _rotated(-a[3], -a[4], -a[5], a[6], b[0] - a[0], b[1] - a[1], b[2] - a[2])
    out[0], out[1], out[2] = x, y, z
    out[3], out[4], out[5], out[6] = product(-a[3], -a[4], -a[5], a[6], b[3], b[4], b[5], b[6])


@compiled(["void(f8[:], f8[:], f8[:])"], "(p),(p)->(p)")
def relative(pose, frame, out):
    """`pose` relative to `frame`."""
    _write_relative(pose, frame, out)


@exact_inlined
def write_reached(pose, twist, dt, out):
    """Write the pose after `dt` seconds of constant world `twist`."""
    x, y, z = twist[3] * dt, twist[4] * dt, twist[5] * dt
    angle = math.sqrt(x * x + y * y + z * z)
    # sin(angle / 2) / angle, by its series where the quotient would lose digits
    scale = math.sin(0.5 * angle) / angle if angle > 1e-4 else 0.5 - angle * angle / 48.0
    quaternion = product(
        x * scale, y * scale, z * scale, math.cos(0.5 * angle), pose[3], pose[4], pose[5], pose[6]
    )
    for i in range(3):
        out[i] = pose[i] + twist[i] * dt
    out[3], out[4], out[5], out[6] = quaternion


@compiled(["void(f8[:], f8[:], f8, f8[:])"], "(p),(t),()->(p)")
def integrate(pose, twist, dt, out):
    """Pose after `dt` seconds of constant world `twist`."""
    write_reached(pose, twist, dt, out)


@exact_inlined
def write_twist(start, end, dt, out):
    """Write the world twist that leads from `start` to `end` in `dt` seconds."""
    x, y, z, w = product(end[3], end[4], end[5], end[6], -start[3], -start[4], -start[5], start[6])
    sine = math.sqrt(x * x + y * y + z * z)
    # angle / sin(angle / 2), by its series where the quotient would lose digits
    scale = 2.0 * math.atan2(sine, w) / sine if sine > 1e-4 else 2.0 + sine * sine / 3.0
    for i in range(3):
        out[i] = (end[i] - start[i]) / dt
    out[3], out[4], out[5] = x * scale / dt, y * scale / dt, z * scale / dt


@compiled(["void(f8[:], f8[:], f8, f8[:], f8[:])"], "(p),(p),(),(t)->(t)")
def twist_between(start, end, dt, like, out):
    """World twist that leads from `start` to `end` in `dt` seconds; `like` has its size."""
    write_twist(start, end, dt, out)


@compiled(["void(f8[:], f8[:], f8[:], f8, f8[:])"], "(p),(p),(p),()->(p)")
def catch_up(pose, target, frame, dt, out):
    """Velocity (3) and rotation (4) that lead from `pose` to `target` in `dt` seconds.

    They and `pose` are relative to `frame`; `target` and `frame` are in a common frame.
    """
    twist = np.empty(6)
    _write_relative(target, frame, out)
    write_twist(pose, out, dt, twist)
    write_reached(IDENTITY, twist, dt, out)
    for i in range(3):
        out[i] = twist[i]


@compiled(["void(f8, f8, f8, f8[:], f8[:])"], "(),(),(),(p)->(p)")
def planar_pose(x, y, angle, like, out):
    """Pose on the floor at a heading; `like` has its size."""
    sine, cosine = math.sin(0.5 * angle), math.cos(0.5 * angle)
    sign = math.copysign(1.0, cosine)  # no comparison, which would warn of NaN
    out[0], out[1], out[2], out[3], out[4] = x, y, 0.0, 0.0, 0.0
    out[5], out[6] = sign * sine, sign * cosine


@compiled(["void(f8[:], f8[:], f8[:], f8[:])"], "(p),(p)->(),()")
def distance(a, b, metres, radians):
    """Metres between two poses, and the angle between them in [0, pi]."""
    x, y, z, w = product(a[3], a[4], a[5], a[6], -b[3], -b[4], -b[5], b[6])
    squared = 0.0
    for i in range(3):
        squared += (a[i] - b[i]) * (a[i] - b[i])
    metres[0] = math.sqrt(squared)
    radians[0] = 2.0 * math.atan2(math.sqrt(x * x + y * y + z * z), w)


@exact_inlined
def clipped(value):
    """Return a number clipped to [-1, 1]; NaN stays."""
    return 1.0 if value > 1.0 else -1.0 if value < -1.0 else value


@exact_inlined
def wrapped(angle):
    """Return the angle in (-pi, pi]."""
    circle = 2.0 * math.pi
    # Twice, because a tiny negative number modulo a circle rounds up to a whole circle.
    return math.pi - (math.pi - angle) % circle % circle


@compiled(["void(f8, f8[:])"], "()->()")
def wrap(angle, out):
    """Angle in (-pi, pi]."""
    out[0] = wrapped(angle)


@exact_inlined
def heading(pose):
    """Return the heading of a pose on the floor, radians in (-pi, pi]."""
    return wrapped(2.0 * math.atan2(pose[5], pose[6]))


@compiled(["void(f8[:], f8[:])"], "(p)->()")
def yaw(pose, out):
    """Heading of a pose on the floor, radians in (-pi, pi]."""
    out[0] = heading(pose)


@compiled(["void(f8[:], f8[:], f8[:], f8[:])"], "(p),(p),(v)->(v)")
def planar_offset(pose, frame, like, out):
    """x, y and yaw of a pose on the floor, relative to another pose; 0 for NaN."""
    out[:] = 0.0
    if not math.isnan(pose.sum()):
        angle, x, y = heading(frame), pose[0] - frame[0], pose[1] - frame[1]
        cosine, sine = math.cos(angle), math.sin(angle)
        out[0], out[1] = cosine * x + sine * y, cosine * y - sine * x
        out[2] = wrapped(heading(pose) - angle)


@compiled(["void(f8[:], f8[:], b1[:], f8[:])"], "(j),(j),(j)->(j)")
def joint_displacement(before, after, continuous, out):
    """Displacement of each joint; for continuous joints the shorter of the two."""
    for j in range(len(before)):
        change = after[j] - before[j]
        out[j] = wrapped(change) if continuous[j] else change


@compiled(["void(f8[:], f8[:], b1[:], f8[:], b1[:])"], "(j),(j),(j),(j)->()")
def moves_farther(before, after, continuous, longest, out):
    """Whether a joint moves farther than its `longest` displacement; as `joint_displacement`."""
    out[0] = False
    for j in range(len(before)):
        change = after[j] - before[j]
        if abs(wrapped(change) if continuous[j] else change) > longest[j]:
            out[0] = True


@compiled(["void(f8[:,:], f8[:,:], f8[:], f8[:], b1[:])"], "(k,p),(k,p),(k),(k)->()")
def obstacles_are_finite(point, normal, distance, closing_speed, out):
    """Whether the numbers of obstacles are finite; their distances may be inf."""
    out[0] = True
    for k in range(len(distance)):
        total = point[k, 0] + point[k, 1] + normal[k, 0] + normal[k, 1] + closing_speed[k]
        if not (math.isfinite(total) and distance[k] > -math.inf):
            out[0] = False


TWIST = np.zeros(6)
"""Argument `like` of kernels, which has the size of what they return: a twist."""
