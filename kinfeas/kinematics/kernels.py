"""Compilation of kernels, and small ones: copies, squares, poses from matrices and back."""

from numba import njit

from kinfeas.core.kernel_cache import FAST, UNCOUNTED
from kinfeas.core.pose_kernels import product

# numpy's error model has no zero check at divisions. Results are deterministic. Without
# `forceinline=False` a kernel is inlined everywhere if its first caller is. Functions that compute
# numbers for other kernels are inlined: otherwise each kernel has its own, regrouped copy, and the
# kernels that a process compiled before determine which copy runs. No kernel has a `**`, since
# numba compiles it once in a process, with the flags of the first kernel.
kernel = njit(cache=True, error_model="numpy", fastmath=FAST, nogil=True, forceinline=False)
inner = njit(
    cache=True, error_model="numpy", fastmath=FAST, nogil=True, forceinline=False, **UNCOUNTED
)
inlined = njit(cache=True, error_model="numpy", fastmath=FAST, forceinline=True, **UNCOUNTED)


@inlined
def copy_row(values, out):
    """Copy values, shape (n,); a slice assignment takes much longer to compile."""
    for i in range(len(values)):
        out[i] = values[i]


@inlined
def square(value):
    """Return the square."""
    return value * value


@inlined
def write_matrix(pose, out):
    """Write the orientation of a pose, shape (7,), as a matrix, shape (3, 3)."""
    x, y, z, w = pose[3], pose[4], pose[5], pose[6]
    s = 2.0 / (x * x + y * y + z * z + w * w)
    out[0, 0], out[1, 1] = 1.0 - s * (y * y + z * z), 1.0 - s * (x * x + z * z)
    out[2, 2] = 1.0 - s * (x * x + y * y)
    out[0, 1], out[1, 0] = s * (x * y - z * w), s * (x * y + z * w)
    out[0, 2], out[2, 0] = s * (x * z + y * w), s * (x * z - y * w)
    out[1, 2], out[2, 1] = s * (y * z - x * w), s * (y * z + x * w)


@inlined
def write_pose(position, matrix, out):
    """Write a position, shape (3,), and a rotation matrix, shape (3, 3), as a pose, shape (7,).

    The largest component comes from the diagonal, the others from quotients by it (Shepperd, J.
    Guidance and Control 1978).
    """
    a, b, c = matrix[0, 0], matrix[1, 1], matrix[2, 2]
    if a + b + c > 0.0:
        w = 1.0 + a + b + c
        x, y = matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0]
        z = matrix[1, 0] - matrix[0, 1]
    elif a >= b and a >= c:
        x, w = 1.0 + a - b - c, matrix[2, 1] - matrix[1, 2]
        y, z = matrix[0, 1] + matrix[1, 0], matrix[0, 2] + matrix[2, 0]
    elif b >= c:
        y, w = 1.0 + b - a - c, matrix[0, 2] - matrix[2, 0]
        x, z = matrix[0, 1] + matrix[1, 0], matrix[1, 2] + matrix[2, 1]
    else:
        z, w = 1.0 + c - a - b, matrix[1, 0] - matrix[0, 1]
        x, y = matrix[0, 2] + matrix[2, 0], matrix[1, 2] + matrix[2, 1]
    for i in range(3):
        out[i] = position[i]
    out[3], out[4], out[5], out[6] = product(x, y, z, w, 0.0, 0.0, 0.0, 1.0)
