"""The path that a learned model stands for, in a table to read from at every step."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from kinfeas.core.spatial import (
    Array,
    compose,
    integrate,
    make_pose,
    planar_pose,
    rotation,
    twist_between,
)
from kinfeas.plugins.model import Model

_SEGMENTS = 256
_PINNED = 0.2  # share of the path over which its end is drawn to the goal


@dataclass(frozen=True)
class Path:
    """Poses of the hand and the base in the frame of the object, at even steps of the index.

    Attributes:
        knots: Poses of the hand, shape (m + 1, 7).
        segments: Twists that lead from each knot to the next in one second, shape (m, 6).
        base: x, y and unwrapped yaw of the base, shape (m + 1, 3), if known.
    """

    knots: Array
    segments: Array
    base: Array | None

    def at(self, index: Array) -> Array:
        """Return the poses of the hand at `index` in [0, 1], shape (n,) -> (n, 7)."""
        i, share = self._segment(index)
        return integrate(self.knots[i], self.segments[i] * share[:, np.newaxis], 1.0)

    def base_at(self, index: Array, object_pose: Array) -> Array:
        """Return the world poses of the base at `index`, shape (n,), not-a-number if unknown.

        Args:
            index: Share of the path in [0, 1], shape (n,).
            object_pose: World pose of the object, shape (n, 7).
        """
        if self.base is None:
            return np.full((len(index), 7), np.nan)
        i, share = self._segment(index)
        base = self.base[i] + (self.base[i + 1] - self.base[i]) * share[:, np.newaxis]
        pose = planar_pose(base[:, 0], base[:, 1], base[:, 2])
        return compose(below(object_pose), pose)

    def _segment(self, index: Array) -> tuple[NDArray[np.intp], Array]:
        """Return which segment `index` lies in, and which share of it is done."""
        count = len(self.segments)
        steps = index * count
        i = np.minimum(steps.astype(np.intp), count - 1)
        return i, steps - i


def tabulate(model: Model) -> Path:
    """Return the path of a model, drawn to the model's goal over its last fifth."""
    index = np.linspace(0.0, 1.0, _SEGMENTS + 1)
    features = regress(model, index)
    turn = Rotation.from_rotvec(features[:, 3:6])
    knots = make_pose(features[:, :3], Rotation.from_quat(model.mean_orientation) * turn)
    share = np.clip((index - 1.0) / _PINNED + 1.0, 0.0, 1.0)
    share = share**2 * (3.0 - 2.0 * share)  # smooth where it begins and ends
    goal = np.array(model.goal)
    goal[3:] /= np.linalg.norm(goal[3:])
    missing = twist_between(knots[-1], goal, 1.0)
    knots = integrate(knots, missing * share[:, np.newaxis], 1.0)
    knots[-1] = make_pose(goal[:3], rotation(goal))
    base = features[:, 6:] if model.has_base else None
    return Path(knots, twist_between(knots[:-1], knots[1:], 1.0), base)


def regress(model: Model, index: Array) -> Array:
    """Return what the mixture expects at `index`, shape (m,) -> (m, d - 1).

    Gaussian mixture regression: the mean of the components' conditional means, weighted by how
    likely each is at `index` (Calinon, Robot Programming by Demonstration, 2009, chapter 2).
    """
    weight = np.array([component.weight for component in model.components])
    mean = np.array([component.mean for component in model.components])
    covariance = np.array([component.covariance for component in model.components])
    away, variance = index[:, np.newaxis] - mean[:, 0], covariance[:, 0, 0]
    likely = np.log(weight) - 0.5 * (away**2 / variance + np.log(variance))
    share = np.exp(likely - likely.max(axis=1, keepdims=True))
    share /= share.sum(axis=1, keepdims=True)
    slope = covariance[:, 1:, 0] / variance[:, np.newaxis]
    expected = mean[:, 1:] + slope * away[:, :, np.newaxis]
    summed: Array = np.sum(share[:, :, np.newaxis] * expected, axis=1)
    return summed


def below(pose: Array) -> Array:
    """Return the frames on the floor below `pose`, shape (n, 7), with the heading of its x axis."""
    x, y, z, w = pose[:, 3], pose[:, 4], pose[:, 5], pose[:, 6]
    heading = np.arctan2(2.0 * (x * y + z * w), w * w + x * x - y * y - z * z)
    return planar_pose(pose[:, 0], pose[:, 1], heading)
