"""How kernels of kinematics are compiled, and the smallest of them."""

from numba import njit

from kinfeas.core import kernel_cache

kernel_cache.settle()  # before the first kernel

# numpy's error model spares a zero check at every division; the kernels guard their own. Sums may
# be regrouped and multiply-adds fused, always in the same way: results stay deterministic. A kernel
# that did not say that it is not inlined would be, everywhere, if its first caller is. What finds
# numbers for other kernels is inlined, for else each of them has a copy of it, regrouped in its own
# way, and what else a process has compiled decides which copy runs. No kernel has a `**`: numba
# compiles it once in a process, and whoever asks first says whether it may be regrouped.
_FAST = {"contract", "reassoc", "nsz"}
kernel = njit(cache=True, error_model="numpy", fastmath=_FAST, nogil=True, forceinline=False)
inlined = njit(cache=True, error_model="numpy", fastmath=_FAST, forceinline=True)


@inlined
def copy_row(values, out):
    """Write the same values, shape (n,).

    An assignment to a slice would compile numpy's broadcasting and the making of its messages
    along, at times for minutes.
    """
    for i in range(len(values)):
        out[i] = values[i]


@inlined
def square(value):
    """Return the value times itself."""
    return value * value
