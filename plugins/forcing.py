"""The force of a dynamic movement primitive, learned by the package `movement_primitives`."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import Array
from kinfeas.plugins.recording import resampled

_SAMPLES = 201  # of the demonstration, at even steps of time
_SEGMENTS = 256  # of the table
_MOST = 100  # basis functions; more than half the samples would only follow the noise
_LAST_PHASE = 0.01  # at the end of the demonstrated time; the library's own


@dataclass(frozen=True)
class Forcing:
    """Force over time, in units of the demonstration's duration.

    Attributes:
        weights: The force per phase at even moments in [0, 1], shape (m + 1, 6).
    """

    weights: Array

    def phase(self, time: Array) -> Array:
        """Return what falls from 1 to 0.01 within the duration, and on, shape (n,) -> (n,)."""
        phase: Array = np.exp(np.log(_LAST_PHASE) * time)
        return phase

    def at(self, time: Array) -> Array:
        """Return the force, shape (n,) -> (n, 6), in m and rad per squared duration."""
        steps = np.minimum(time, 1.0) * (len(self.weights) - 1)
        i = np.minimum(steps.astype(np.intp), len(self.weights) - 2)
        share = (steps - i)[:, np.newaxis]
        weights = self.weights[i] * (1.0 - share) + self.weights[i + 1] * share
        return weights * self.phase(time)[:, np.newaxis]


def learn(time: Array, poses: Array, basis_functions: int, alpha: float) -> Forcing:
    """Return the force that makes a spring do what was shown.

    Args:
        time: Moments in seconds, strictly ascending, shape (t,).
        poses: What was shown then, shape (t, 7).
        basis_functions: Size of the model in each direction.
        alpha: Damping of the spring, whose stiffness is a quarter of its square.

    Raises:
        KinfeasError: If `movement_primitives` is not installed, or the size is out of range.
    """
    size = basis_functions
    if not isinstance(size, int) or isinstance(size, bool) or not 2 <= size <= _MOST:
        raise KinfeasError(f"basis_functions must be a whole number in [2, {_MOST}], not {size!r}")
    library, alphas = _library(), {"alpha_y": alpha, "beta_y": alpha / 4.0}
    moments = np.linspace(0.0, 1.0, _SAMPLES)
    model = library(1.0, 1.0 / _SAMPLES, size, smooth_scaling=True, **alphas)
    model.imitate(moments, _for_library(resampled(time, poses, moments)))
    table = np.linspace(0.0, 1.0, _SEGMENTS + 1)
    terms = model.forcing_term_pos, model.forcing_term_rot
    force = np.concatenate([term(table) for term in terms]).T
    return Forcing(force / Forcing(force).phase(table)[:, np.newaxis])


def _library() -> Any:
    """Return the library's class of Cartesian movement primitives."""
    try:
        from movement_primitives.dmp import CartesianDMP
    except ImportError as error:
        raise KinfeasError(
            'dmp needs the package movement_primitives: pip install "kinfeas[dmp]"'
        ) from error
    return CartesianDMP


def _for_library(poses: Array) -> Array:
    """Return poses with quaternions wxyz, each of the sign that is nearest to the one before."""
    quaternion = np.roll(poses[:, 3:], 1, axis=1)
    flips = np.sum(quaternion[1:] * quaternion[:-1], axis=1) < 0.0
    signs = np.concatenate([[1.0], np.where(np.cumsum(flips) % 2 == 1, -1.0, 1.0)])
    return np.concatenate([poses[:, :3], quaternion * signs[:, np.newaxis]], axis=1)
