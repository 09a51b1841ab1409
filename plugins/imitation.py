"""Motions learned from demonstrations, `imitation` and `gaussian_mixture`, and their model files.

A model is a Gaussian mixture over the pose of the EE, in plain YAML::

    format: 2
    kind: imitation                     # or gaussian_mixture: the meaning of the index
    duration: 3.1                       # seconds
    goal: [x, y, z, qx, qy, qz, qw]     # pose of the EE at the end, in the frame of the object
    mean_orientation: [qx, qy, qz, qw]  # frame of rotation vectors
    fitted_from: {demonstrations: 20, command: kinfeas fit ...}
    components:
    - weight: 0.125
      mean: [index, x, y, z, rx, ry, rz, base_x, base_y, base_yaw]
      covariance: [...]                 # of the index with these; the first is its variance

The index is a fraction of the path in [0, 1] (`imitation`: by length, `gaussian_mixture`: by
time). Positions are metres in the frame of the object at the start; r is the rotation vector from
the mean orientation, in its own axes. The base moves on the floor, in the frame below the object
with its heading; a model without a base stops at rz. Files of format 1, with all columns of a
covariance, are read as well.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Interval
from scipy.spatial.transform import Rotation

from kinfeas import config
from kinfeas.config import strict_yaml
from kinfeas.core.errors import KinfeasError, no_such
from kinfeas.core.files import is_path
from kinfeas.core.motion import State, TwistAndState
from kinfeas.core.quantities import Count, Positive, PositiveFraction
from kinfeas.core.spatial import Array, compose, integrate, make_pose, rotation, twist_between
from kinfeas.plugins.path import PathMotion, PosePath, slowed

Kind = Literal["imitation", "gaussian_mixture"]
# Beyond any room or rotation, and small enough that results do not overflow.
Bounded = Annotated[float, Interval(ge=-1000.0, le=1000.0)]

SHORTEST, LONGEST = 0.01, 3600.0  # durations of learned motions, seconds
_SIZE, _SIZE_WITH_BASE = 7, 10  # numbers of a component's mean
_FOLDER = Path(__file__).parent / "models"
_ROUNDING = 1e-6  # error of quaternions and weights
_SMALLEST = 1e-12  # variance of the index: a millionth of the path, squared
_SEGMENTS = 256  # of a path
_PINNED = 0.2  # fraction of the path over which its end is drawn to the goal


class Imitation(PathMotion):
    """A demonstrated path in the frame of the grasped object, from any start.

    The EE first comes to the beginning of the learned path, then moves as demonstrated, and ends at
    the learned end exactly: the phase dynamic system of `PathMotion`.

    Args:
        model: Name of a shipped model (door_grasp, door_open, drawer_grasp or drawer_open), or path
            of a file that `kinfeas fit` wrote.
        gain: Rate at which errors decay, 1/s.
        position_scale: The length a: the error at which the phase slows down by e, in metres.
        rotation_scale: The same angle b in radians.
        max_velocity: Upper limit of the speed in m/s.
        max_angular_velocity: Upper limit of the angular speed in rad/s.
    """

    def __init__(
        self,
        *,
        model: str,
        gain: Positive = 1.0,
        position_scale: Positive = 0.05,
        rotation_scale: Positive = 0.3,
        max_velocity: Positive = 0.1,
        max_angular_velocity: Positive = 0.1,
    ) -> None:
        learned = read_model(model, "imitation")
        super().__init__(
            path=learned_path(learned),
            duration=learned.duration,
            gain=gain,
            position_scale=position_scale,
            rotation_scale=rotation_scale,
            max_velocity=max_velocity,
            max_angular_velocity=max_angular_velocity,
        )


class GaussianMixture(PathMotion):
    """A time-indexed mixture of EE and base poses, in the frame of the grasped object.

    Gaussian mixture regression gives a reference pose for each moment, which the EE follows as fast
    as its limits allow. Time never waits: if the start is far away, the reference runs ahead, and
    the beginning of the demonstrated motion is lost (`imitation` keeps it).

    Args:
        model: Path of a file that `kinfeas fit --kind gaussian_mixture` wrote.
        max_velocity: Upper limit of the speed in m/s.
        max_angular_velocity: Upper limit of the angular speed in rad/s.
    """

    def __init__(
        self, *, model: str, max_velocity: Positive = 0.1, max_angular_velocity: Positive = 0.1
    ) -> None:
        learned = read_model(model, "gaussian_mixture")
        super().__init__(
            path=learned_path(learned),
            duration=learned.duration,
            position_scale=np.inf,
            max_velocity=max_velocity,
            max_angular_velocity=max_angular_velocity,
        )

    def twist(self, state: State, ee_pose: Array, target_pose: Array, dt: Array) -> TwistAndState:
        """Return the world twist for the next `dt` seconds, shape (n, 6), and the next state."""
        phase = np.minimum(state["phase"] + dt / self.duration, 1.0)
        twist = twist_between(ee_pose, compose(target_pose, self.path.at(phase)), dt)
        scale = slowed(twist, self.max_velocity, self.max_angular_velocity)
        return twist * scale[:, np.newaxis], {"phase": phase}


@dataclass(frozen=True)
class Component:
    """One Gaussian of the mixture."""

    weight: PositiveFraction  # weight; those of all components add up to 1
    # index, EE x y z and EE rotation vector; with a base also its x, y and yaw. Metres and radians
    mean: tuple[Bounded, ...]
    # covariance of the index with each number of the mean; the first one is its variance
    covariance: tuple[Bounded, ...]

    def __post_init__(self) -> None:
        size = len(self.mean)
        if size not in (_SIZE, _SIZE_WITH_BASE):
            raise ValueError(f"the mean must have {_SIZE} or {_SIZE_WITH_BASE} numbers, not {size}")
        if len(self.covariance) != size:
            raise ValueError(f"the covariance must have {size} numbers, as the mean")
        if self.covariance[0] < _SMALLEST:
            raise ValueError(f"the variance of the index must be at least {_SMALLEST:g}")


@dataclass(frozen=True)
class Source:
    """The origin of a model."""

    demonstrations: Count  # number of demonstrations
    command: str  # command that fitted it


@dataclass(frozen=True)
class Model:
    """A learned motion in the frame of the grasped object; see the example of this module."""

    format: Literal[2]  # version of the file format
    kind: Kind  # motion generator: whether the index is that of the length or of the time
    duration: Annotated[float, Interval(ge=SHORTEST, le=LONGEST)]  # duration of the motion, seconds
    # final EE pose in the frame of the object, metres, quaternion x y z w
    goal: tuple[Bounded, Bounded, Bounded, float, float, float, float]
    # quaternion x y z w that rotation vectors are relative to
    mean_orientation: tuple[float, float, float, float]
    fitted_from: Source  # origin of the model
    components: tuple[Component, ...]  # Gaussians of the mixture

    def __post_init__(self) -> None:
        quaternions = {"goal": self.goal[3:], "mean_orientation": self.mean_orientation}
        for name, quaternion in quaternions.items():
            if abs(float(np.linalg.norm(quaternion)) - 1.0) > _ROUNDING:
                raise ValueError(f"{name!r} must have a unit quaternion (xyzw)")
        if len({len(component.mean) for component in self.components}) != 1:
            raise ValueError("'components' must be one or more, all of the same size")
        if abs(sum(component.weight for component in self.components) - 1.0) > _ROUNDING:
            raise ValueError("the weights of 'components' must add up to 1")

    @property
    def has_base(self) -> bool:
        """Whether the base was learned along with the EE."""
        return len(self.components[0].mean) == _SIZE_WITH_BASE


def read_model(name_or_path: str, kind: Kind) -> Model:
    """Return the shipped model of this name (`door_open`), or that of a file (`my/model.yaml`)."""
    path = Path(name_or_path)
    if not is_path(name_or_path):
        shipped = [model.stem for model in _FOLDER.glob("*.yaml")]
        if name_or_path not in shipped:
            hint = no_such(name_or_path, shipped)
            raise KinfeasError(f"unknown model {name_or_path!r}{hint}, or the path of a .yaml file")
        path = _FOLDER / f"{name_or_path}.yaml"
    model = config.from_mapping(Model, _read(path), str(path))
    if model.kind != kind:
        raise KinfeasError(f"{path}: 'kind' must be {kind!r} here, not {model.kind!r}")
    return model


def _read(path: Path) -> Any:
    """Return the content of a model file, converted to format 2."""
    data: Any = strict_yaml.read(path)
    if data.get("format") == 1:
        try:
            for component in data["components"]:
                component["covariance"] = [row[0] for row in component["covariance"]]
        except (LookupError, TypeError) as error:
            rule = "must be mappings with a 'covariance' of rows of numbers"
            raise KinfeasError(f"{path}: 'components' {rule}") from error
        data["format"] = 2
    return data


def learned_path(model: Model) -> PosePath:
    """Return the path of a model, drawn to the model's goal over its last fifth."""
    index = np.linspace(0.0, 1.0, _SEGMENTS + 1)
    features = regress(model, index)
    orientation = Rotation.from_rotvec(features[:, 3:6])
    knots = make_pose(features[:, :3], Rotation.from_quat(model.mean_orientation) * orientation)
    fraction = np.clip((index - 1.0) / _PINNED + 1.0, 0.0, 1.0)
    fraction = fraction**2 * (3.0 - 2.0 * fraction)  # smooth where it begins and ends
    goal = np.array(model.goal)
    goal[3:] /= np.linalg.norm(goal[3:])
    missing = twist_between(knots[-1], goal, 1.0)
    knots = integrate(knots, missing * fraction[:, np.newaxis], 1.0)
    knots[-1] = make_pose(goal[:3], rotation(goal))
    return PosePath(knots, features[:, 6:] if model.has_base else None)


def regress(model: Model, index: Array) -> Array:
    """Return the expectation of the mixture at `index`, shape (m,) -> (m, d - 1).

    Gaussian mixture regression: the mean of the components' conditional means, weighted by their
    likelihoods at `index` (Calinon, Robot Programming by Demonstration, 2009, chapter 2).
    """
    weight = np.array([component.weight for component in model.components])
    mean = np.array([component.mean for component in model.components])
    covariance = np.array([component.covariance for component in model.components])
    away, variance = index[:, np.newaxis] - mean[:, 0], covariance[:, 0]
    log_likelihood = np.log(weight) - 0.5 * (away**2 / variance + np.log(variance))
    likelihood = np.exp(log_likelihood - log_likelihood.max(axis=1, keepdims=True))
    likelihood /= likelihood.sum(axis=1, keepdims=True)
    slope = covariance[:, 1:] / variance[:, np.newaxis]
    expected = mean[:, 1:] + slope * away[:, :, np.newaxis]
    return np.sum(likelihood[:, :, np.newaxis] * expected, axis=1)
