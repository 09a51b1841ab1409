"""Poses and twists: pure functions on arrays with any leading axes.

A pose is `(..., 7)`: x y z qx qy qz qw in metres with a unit quaternion (xyzw). A twist is
`(..., 6)`: linear then angular velocity along world axes, m/s and rad/s. Other shapes raise a
`KinfeasError`.
"""

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation, Slerp

from kinfeas.core import pose_kernels
from kinfeas.core.errors import KinfeasError

Array = NDArray[np.float64]

IDENTITY: Array = pose_kernels.IDENTITY

POSE_COLUMNS = ("x", "y", "z", "qx", "qy", "qz", "qw")
"""Names of the numbers of a pose in files."""

UNIT = 1e-2
"""Largest deviation of the norm of a quaternion in an input from 1."""

_POSE, _TWIST = (7,), (6,)
_DEGENERATE = 1e-3  # least length of the first column, and of the second one across the first


def rotation(pose: Array) -> Rotation:
    """Return the orientation of `pose`, shape (..., 7)."""
    return Rotation.from_quat(pose[..., 3:])


def rpy(pose: Array) -> Array:
    """Return roll, pitch and yaw about fixed axes, (..., 3), radians; ambiguous in gimbal lock."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of gimbal lock
        return rotation(pose).as_euler("xyz")


def make_pose(position: Array, orientation: Rotation) -> Array:
    """Return the pose at `position`, shape (..., 3) in metres, with an `orientation`."""
    return np.concatenate([position, canonical(orientation.as_quat())], axis=-1)


def from_columns(values: Array) -> Array:
    """Return the poses (..., 7) of positions and two columns of rotation matrices, (..., 9).

    The columns are made orthonormal as by Zhou et al., On the Continuity of Rotation
    Representations in Neural Networks, CVPR 2019. Rows, as PyTorch3D and UMI have them, are
    columns of the inverse rotation.

    Raises:
        KinfeasError: If a column is not finite or zero, or the columns are parallel.
    """
    if values.shape[-1:] != (9,):
        raise KinfeasError(f"the shape must be positions and columns (..., 9), not {values.shape}")
    x, y = values[..., 3:6], values[..., 6:]
    with np.errstate(over="ignore", invalid="ignore"):
        first = np.linalg.norm(x, axis=-1, keepdims=True)
        x = x / np.maximum(first, _DEGENERATE)
        y = y - np.sum(x * y, axis=-1, keepdims=True) * x
        second = np.linalg.norm(y, axis=-1, keepdims=True)
    lengths = np.stack([first, second])
    if not ((lengths > _DEGENERATE) & np.isfinite(lengths)).all():
        raise KinfeasError("the columns of rotations must be finite, not zero and not parallel")
    y = y / second
    matrices = np.stack([x, y, np.cross(x, y)], axis=-1)
    return make_pose(values[..., :3], Rotation.from_matrix(matrices))


def canonical(quaternion: Array) -> Array:
    """Return the same rotations as quaternions with w >= 0, shape (..., 4) xyzw."""
    return np.where(quaternion[..., 3:] < 0.0, -quaternion, quaternion)


def compose(parent: Array, child: Array) -> Array:
    """Return `child`, which is relative to `parent`, in the frame of `parent`; shapes (..., 7)."""
    return _call(pose_kernels.compose, parent, child)


def relative(pose: Array, frame: Array) -> Array:
    """Return `pose` relative to `frame`; both of shape (..., 7), in the same frame."""
    return _call(pose_kernels.relative, pose, frame)


def integrate(pose: Array, twist: Array, dt: ArrayLike) -> Array:
    """Return the pose reached from `pose` after `dt` seconds of constant `twist`.

    Args:
        pose: World pose, shape (..., 7), metres and unit quaternion xyzw.
        twist: World-axes twist, shape (..., 6), m/s and rad/s.
        dt: Duration in seconds, shape (...) or one for all.
    """
    return _call(pose_kernels.integrate, pose, twist, dt, last=_TWIST)


def twist_between(start: Array, end: Array, dt: ArrayLike) -> Array:
    """Return the constant twist that leads from `start` to `end` in `dt` seconds.

    The inverse of `integrate`: shapes (..., 7), (..., 7) -> (..., 6), m/s and rad/s; `dt` may have
    shape (...).
    """
    return _call(pose_kernels.twist_between, start, end, dt, pose_kernels.TWIST)


def catch_up(pose: Array, target: Array, frame: Array, dt: float) -> tuple[Array, Array]:
    """Return velocity (n, 3), m/s, and rotation (n, 4) from poses to targets in `dt` seconds.

    Poses and results are relative to `frame`; targets and `frame` are in a common frame; all poses
    have the shape (n, 7).
    """
    motion: Array = _call(pose_kernels.catch_up, pose, target, frame, dt)
    return motion[:, :3], motion[:, 3:]


def distance(a: Array, b: Array) -> tuple[Array, Array]:
    """Return the distance in metres and the angle in [0, pi] between poses; (..., 7) -> (...)."""
    return _call(pose_kernels.distance, a, b)


def planar_pose(x: Array, y: Array, yaw: Array) -> Array:
    """Return poses on the floor: `x`, `y` in metres, `yaw` in radians, shape (...) -> (..., 7)."""
    return pose_kernels.planar_pose(x, y, yaw, IDENTITY)


def planar_offset(pose: Array, frame: Array) -> Array:
    """Return x, y and yaw of poses on the floor in `frame`, (..., 7) -> (..., 3); 0 for NaN."""
    return _call(pose_kernels.planar_offset, pose, frame, pose_kernels.TWIST[:3])


def yaw(pose: Array) -> Array:
    """Return the heading of planar poses, shape (..., 7) -> (...), radians in (-pi, pi]."""
    if pose.shape[-1:] != _POSE:
        raise KinfeasError(f"the shape must be that of poses (..., 7), not {pose.shape}")
    return pose_kernels.yaw(pose)


def wrap(angle: Array) -> Array:
    """Return `angle` in radians, wrapped to (-pi, pi]."""
    return pose_kernels.wrap(angle)


def _call(
    kernel: Callable[..., Any], pose: Array, other: Array, *more: object, last: tuple[int] = _POSE
) -> Any:
    # Kernels would read or write past arrays of another last axis.
    if pose.shape[-1:] != _POSE or other.shape[-1:] != last:
        kinds = "poses (..., 7)" if last == _POSE else "a pose (..., 7) and a twist (..., 6)"
        raise KinfeasError(f"the shapes must be {kinds}, not {pose.shape} and {other.shape}")
    try:
        return kernel(pose, other, *more)
    except ValueError as error:
        shapes = f"{pose.shape} and {other.shape}"
        raise KinfeasError(f"the leading axes of {shapes} do not broadcast") from error


def interpolated_columns(at: Array, knots: Array, values: Array) -> Array:
    """Return rows at `at`, (m, w), interpolated between `values`, (k, w), at ascending `knots`."""
    return np.stack([np.interp(at, knots, column) for column in values.T], axis=1)


def interpolated(times: Array, samples: Array, poses: Array) -> Array:
    """Return poses at `times`, (m, 7), interpolated between `poses`, (t, 7), at `samples`.

    `samples` are ascending times.
    """
    position = interpolated_columns(times, samples, poses[:, :3])
    return make_pose(position, Slerp(samples, rotation(poses))(times))


def continuous(quaternions: Array) -> Array:
    """Return quaternions of the same rotations whose sign never flips, shape (..., k, 4)."""
    cosine = np.sum(quaternions[..., 1:, :] * quaternions[..., :-1, :], axis=-1)
    signs = np.cumprod(np.where(cosine < 0.0, -1.0, 1.0), axis=-1)
    smooth = quaternions.copy()
    smooth[..., 1:, :] *= signs[..., np.newaxis]
    return smooth
