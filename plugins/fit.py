"""Motions learned from recorded demonstrations: the work of `kinfeas fit`.

A demonstration is a file `anything.csv` with a header and a line for each moment, in metres and
unit quaternions xyzw::

    time,ee_x,ee_y,ee_z,ee_qx,ee_qy,ee_qz,ee_qw,base_x,...,base_qw,object_x,...,object_qw
    0.00,0.71,0.02,0.80,0,0,0,1,0.0,0.0,0,0,0,0,1,1.10,0.00,0.85,0,0,0,1
    0.05,0.72,0.02,0.80,0,0,0,1,0.0,0.0,0,0,0,0,1,1.10,0.00,0.85,0,0,0,1
    0.10,0.74,0.02,0.81,0,0,0,1,0.0,0.0,0,0,0,0,1,1.10,0.00,0.85,0,0,0,1

The motion is learned in the frame of the object in the first line: how the EE moves the object
afterwards is part of the motion.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from kinfeas import config
from kinfeas.config import strict_yaml
from kinfeas.core import spatial
from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import Array
from kinfeas.io.demonstrations import Demonstration, unit_hint
from kinfeas.plugins.imitation import (
    LONGEST,
    SHORTEST,
    Component,
    Kind,
    Model,
    Source,
    learned_path,
)
from kinfeas.plugins.path import below
from kinfeas.plugins.replay import resampled

_SAMPLES = 200  # of each demonstration
_DIGITS = 8  # significant digits of the numbers in a model
_CLOCK = 30.0  # seconds that a `gaussian_mixture` takes, as the authors' models do
_METRES_PER_RADIAN = 0.2  # so that the index of `imitation` also advances in a rotation on the spot
_STILL = 1e-3  # metres from its start, below which a demonstration has no motion to learn
_MAX_ROTATION = 3.0  # radians from the mean orientation; at pi the rotation vector jumps
_FARTHEST = 30.0  # metres from the object
_STRONG = 0.7  # silhouette from which demonstrations follow two paths
_APART = 0.1  # least distance between two such paths, as a fraction of the learned length
_OUTLIER, _OFF = 3.0, 0.1  # medians and metres; a residual above both is that of an outlier
_PART, _TURNED = 0.25, 0.3  # fraction of its path, and radians; each suffices for an outlier
_FEWEST = 3  # samples of a demonstration
_REGULARIZATION = 1e-6  # added to variances: a millimetre, a milliradian, a thousandth of the path


@dataclass(frozen=True)
class MotionFit:
    """A learned motion, and its distance from the demonstrations.

    Its `sides` differ where demonstrations follow two paths, such as left and right of an obstacle,
    and the learned one leads between them.
    """

    model: Model  # the motion
    duration: float  # mean duration of the demonstrations in seconds
    length: float  # length of the learned EE path in metres
    position_residual: tuple[float, ...]  # mean distances from the learned path, metres
    rotation_residual: tuple[float, ...]  # the same in radians
    sides: tuple[int, ...]  # 0 or 1 for each demonstration
    names: tuple[str, ...]  # names of the demonstrations
    has_base: tuple[bool, ...]  # whether each demonstration has poses of the base
    outliers: tuple[str, ...]  # names of those that are far from the path


@dataclass(frozen=True)
class _Path:
    """EE poses, (m, 7), in the frame of the object, and x, y and unwrapped yaw of the base, (m, 3).

    Both are at even steps of the index; an unknown base is NaN. Duration in seconds.
    """

    ee_pose: Array
    base: Array
    duration: float


def fit(
    demonstrations: Sequence[Demonstration],
    kind: Kind = "imitation",
    components: int = 8,
    seed: int = 0,
    command: str = "",
    names: Sequence[str] = (),
) -> MotionFit:
    """Return the motion learned from demonstrations by expectation maximization.

    The base is learned too if its poses are finite in all of them. `imitation` indexes the motion
    by length, `gaussian_mixture` by time. `command` is the origin to write into the model, `names`
    are those of the demonstrations in errors, by default their numbers.

    Raises:
        KinfeasError: If there are none, one has fewer than three samples, does not move or moves
            too far, or they turn too far.
    """
    if not demonstrations:
        raise KinfeasError("there must be at least one demonstration to learn from")
    labels = names or [f"demonstration {number}" for number in range(1, len(demonstrations) + 1)]
    paths = [
        _sampled(demonstration, kind, name)
        for demonstration, name in zip(demonstrations, labels, strict=True)
    ]
    duration = float(np.mean([path.duration for path in paths]))
    if not SHORTEST <= duration <= LONGEST:
        raise KinfeasError(
            f"the demonstrations take {duration:g} s, where {SHORTEST:g} to {LONGEST:g} s are "
            f"allowed{unit_hint(demonstrations[0].time)}"
        )
    goals = np.stack([path.ee_pose[-1] for path in paths])
    mean_orientation = spatial.rotation(np.concatenate([path.ee_pose for path in paths])).mean()
    features = _features(paths, mean_orientation)
    model = Model(
        format=2,
        kind=kind,
        duration=_plain(duration if kind == "imitation" else _CLOCK),
        goal=_plain(spatial.make_pose(goals[:, :3].mean(axis=0), spatial.rotation(goals).mean())),
        mean_orientation=_plain(spatial.canonical(mean_orientation.as_quat())),
        fitted_from=Source(len(paths), command),
        components=_mixture(features, components, seed),
    )
    learned = learned_path(model).at(np.linspace(0.0, 1.0, _SAMPLES))
    apart = np.array([spatial.distance(learned, path.ee_pose) for path in paths])
    metres, radians = apart.mean(axis=2).T.tolist()
    length, whole = _length(learned)
    sides = _sides(features, len(paths), whole)
    # The median includes the demonstration itself: hardly higher, and it exists for a single one.
    common = max(_OUTLIER * np.median(metres), _OFF)
    outliers = tuple(
        name
        for name, path, off, turned in zip(labels, paths, metres, radians, strict=True)
        if off > min(common, _PART * _length(path.ee_pose)[1]) or turned > _TURNED
    )
    bases = tuple(demonstration.has_base for demonstration in demonstrations)
    return MotionFit(
        model, duration, length, tuple(metres), tuple(radians), sides, tuple(labels), bases,
        outliers,
    )  # fmt: skip


def write_model(model: Model, path: Path) -> None:
    """Write a YAML file that `kinfeas.plugins.imitation.read_model` reads back."""
    strict_yaml.write(config.to_mapping(model), path, compact=True)


def _sampled(demonstration: Demonstration, kind: Kind, name: str) -> _Path:
    """Return a demonstration at even steps of the index; `name` is its name in errors."""
    if (count := len(demonstration.time)) < _FEWEST:
        raise KinfeasError(f"{name}: has {count} samples, at least {_FEWEST} are needed")
    frame = demonstration.object_pose[:1]
    ee_pose = spatial.relative(demonstration.ee_pose, frame)
    metres, radians = spatial.distance(ee_pose[:-1], ee_pose[1:])
    steps = metres + _METRES_PER_RADIAN * radians
    moved, turned = (float(far.max()) for far in spatial.distance(ee_pose, ee_pose[:1]))
    if moved + _METRES_PER_RADIAN * turned < _STILL:
        raise KinfeasError(f"{name}: the EE hardly moves: by {moved:.1g} m and {turned:.1g} rad")
    if kind == "gaussian_mixture":
        steps = np.diff(demonstration.time)
    # The two sums round differently: the index may end a little past 1, or before it.
    index = np.concatenate([[0.0], np.minimum(np.cumsum(steps) / steps.sum(), 1.0)])
    moves = np.concatenate([[True], np.diff(index) > 0.0])
    index, even = index[moves], np.linspace(0.0, 1.0, _SAMPLES)
    index[-1] = 1.0
    sampled = resampled(index, ee_pose[moves], even)
    planar = _planar(demonstration.base_pose, frame)
    base = spatial.interpolated_columns(even, index, planar[moves])
    if np.nanmax(np.abs([sampled[:, :3], base])) > _FARTHEST:
        raise KinfeasError(
            f"{name}: leads more than {_FARTHEST:g} m from the object (are these millimetres?)"
        )
    duration = float(demonstration.time[-1] - demonstration.time[0])
    return _Path(sampled, base, duration)


def _length(ee_pose: Array) -> tuple[float, float]:
    """Return the length of a path, (m, 7), in metres, and that with rotations."""
    metres, radians = spatial.distance(ee_pose[:-1], ee_pose[1:])
    return float(metres.sum()), float((metres + _METRES_PER_RADIAN * radians).sum())


def _planar(base_pose: Array, frame: Array) -> Array:
    """Return x, y and unwrapped yaw of the base in the frame below the object, shape (t, 3)."""
    if not np.isfinite(base_pose).all():
        return np.full((len(base_pose), 3), np.nan)
    pose = spatial.relative(below(base_pose), below(frame))
    return np.stack([pose[:, 0], pose[:, 1], np.unwrap(spatial.yaw(pose))], axis=-1)


def _features(paths: Sequence[_Path], mean_orientation: Rotation) -> Array:
    ee_pose = np.concatenate([path.ee_pose for path in paths])
    rotation_vector = (mean_orientation.inv() * spatial.rotation(ee_pose)).as_rotvec()
    if np.linalg.norm(rotation_vector, axis=1).max() > _MAX_ROTATION:
        raise KinfeasError(
            f"the EE turns more than {_MAX_ROTATION:g} rad away from its mean orientation; "
            "cut the demonstrations into shorter ones"
        )
    index = np.tile(np.linspace(0.0, 1.0, _SAMPLES), len(paths))
    features = np.concatenate([index[:, np.newaxis], ee_pose[:, :3], rotation_vector], axis=1)
    base = _bases(paths)
    return features if np.isnan(base).any() else np.concatenate([features, base], axis=1)


def _bases(paths: Sequence[_Path]) -> Array:
    """Return x, y and yaw of the base, shape (paths * m, 3), without jumps of 2 pi."""
    first_yaw = np.array([path.base[0, 2] for path in paths])
    shift = spatial.wrap(first_yaw - first_yaw[0]) + first_yaw[0] - first_yaw
    bases = np.stack([path.base for path in paths])
    bases[:, :, 2] += shift[:, np.newaxis]
    return bases.reshape(-1, 3)


def _mixture(features: Array, components: int, seed: int) -> tuple[Component, ...]:
    from sklearn.mixture import GaussianMixture
    from threadpoolctl import threadpool_limits

    search = GaussianMixture(components, reg_covar=_REGULARIZATION, max_iter=500, random_state=seed)
    with threadpool_limits(1):  # threads would sum in another order each time
        mixture = search.fit(features)
    return tuple(
        Component(
            _plain(mixture.weights_[i]),
            _plain(mixture.means_[i]),
            _plain(mixture.covariances_[i][:, 0]),
        )
        for i in np.argsort(mixture.means_[:, 0])
    )


def _sides(features: Array, count: int, length: float) -> tuple[int, ...]:
    """Return the path, 0 or 1, of each of `count` demonstrations; all 0 if they follow the same.

    Two clusters count as two paths if their mean silhouette is that of a strong structure (Kaufman
    and Rousseeuw, Finding Groups in Data, 1990), which fewer than four demonstrations cannot have,
    and their means are apart by a fraction of the `length` of the learned path. Scattered starts do
    not count: the part of the start's offset that is left at an index is subtracted there.
    """
    from sklearn.cluster import AgglomerativeClustering
    from sklearn.metrics import silhouette_score

    same = (0,) * count
    if count < 4:
        return same
    offset = features[:, 1:7].reshape(count, _SAMPLES, 6) * np.repeat([1.0, _METRES_PER_RADIAN], 3)
    offset -= offset.mean(axis=0)
    start = offset[:, :1].copy()
    left = np.sum(offset * start, axis=(0, 2)) / max(float(np.sum(start**2)), _STILL**2)
    offset -= np.clip(left, 0.0, 1.0)[:, np.newaxis] * start
    smooth = offset.reshape(count, 10, -1, 6).mean(axis=2).reshape(count, -1)
    side = AgglomerativeClustering(2).fit_predict(smooth)
    apart = offset[side == 1].mean(axis=0) - offset[side == 0].mean(axis=0)
    far = np.linalg.norm(apart, axis=1).max() > _APART * length
    if not far or silhouette_score(smooth, side) < _STRONG:
        return same
    return tuple(side.tolist())


def _plain(values: Any) -> Any:
    """Return an array as nested tuples of numbers, rounded to the digits of a model."""
    if np.ndim(values):
        return tuple(_plain(value) for value in values)
    return float(f"{float(values):.{_DIGITS}g}")
