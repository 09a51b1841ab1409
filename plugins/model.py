"""Learned motions as files: a Gaussian mixture over the pose of the hand, in plain YAML.

A file holds what `Model` says, a component for each entry of the mixture::

    format: 1
    kind: imitation                     # or gaussian_mixture: what its first number stands for
    duration: 3.1                       # seconds
    goal: [x, y, z, qx, qy, qz, qw]     # where the hand ends, in the frame of the object
    mean_orientation: [qx, qy, qz, qw]  # what rotation vectors are relative to
    fitted_from: {demonstrations: 20, command: kinfeas fit ...}
    components:
    - weight: 0.125
      mean: [index, x, y, z, rx, ry, rz, base_x, base_y, base_yaw]
      covariance:
      - [...]                           # as many rows and columns

The index is the share of the way in [0, 1] (`imitation`: of its length, `gaussian_mixture`: of its
time). Positions are metres in the frame that the object has at the start; r is the rotation vector
from the mean orientation, in its own axes. The base moves on the floor, in the frame below the
object that has its heading; a model that knows no base stops at rz. Only the first column of a
covariance is used.
"""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np

from kinfeas import config
from kinfeas.config import Interval, no_such, strict_yaml
from kinfeas.config.quantities import Count, PositiveShare
from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import Array
from kinfeas.io.files import is_path

Kind = Literal["imitation", "gaussian_mixture"]
# Far beyond any room or turn, and near enough that nothing computed from it overflows.
Number = Annotated[float, Interval(low=-1000.0, high=1000.0)]

FORMAT = 1
"""Version of the file format."""

DURATIONS = Interval(low=0.01, high=3600.0)
"""Seconds that a motion may take."""

SIZE, SIZE_WITH_BASE = 7, 10
"""How many numbers a component's mean has without and with the base."""

_FOLDER = Path(__file__).parent / "models"
_ROUNDING = 1e-6  # that quaternions and weights may show
_SMALLEST = 1e-12  # variance of the index: a millionth of the way, squared
_DIGITS = 8  # significant ones that are written; more would only record rounding


@dataclass(frozen=True)
class Component:
    """One Gaussian of the mixture."""

    weight: PositiveShare
    mean: tuple[Number, ...]
    covariance: tuple[tuple[Number, ...], ...]

    def __post_init__(self) -> None:
        """Raise ValueError if the sizes do not fit, or the index does not vary."""
        size = len(self.mean)
        if size not in (SIZE, SIZE_WITH_BASE):
            raise ValueError(f"the mean must have {SIZE} or {SIZE_WITH_BASE} numbers, not {size}")
        if len(self.covariance) != size or any(len(row) != size for row in self.covariance):
            raise ValueError(f"the covariance must have {size} rows of {size} numbers")
        if self.covariance[0][0] < _SMALLEST:
            raise ValueError(f"the variance of the index must be at least {_SMALLEST:g}")


@dataclass(frozen=True)
class Source:
    """What a model was fitted from."""

    demonstrations: Count
    command: str


@dataclass(frozen=True)
class Model:
    """A learned motion, in the frame of the handled object.

    Attributes:
        format: Version of the file format.
        kind: Which motion generator follows it.
        duration: How long it takes, in seconds.
        goal: Pose of the hand at the end.
        mean_orientation: Quaternion xyzw that rotation vectors are relative to.
        fitted_from: Where it comes from.
        components: The mixture; see the head of this module for what its numbers are.
    """

    format: Literal[1]
    kind: Kind
    duration: Annotated[float, DURATIONS]
    goal: tuple[Number, Number, Number, float, float, float, float]
    mean_orientation: tuple[float, float, float, float]
    fitted_from: Source
    components: tuple[Component, ...]

    def __post_init__(self) -> None:
        """Raise ValueError if the parts do not fit."""
        for name, quaternion in (
            ("goal", self.goal[3:]),
            ("mean_orientation", self.mean_orientation),
        ):
            if abs(float(np.linalg.norm(quaternion)) - 1.0) > _ROUNDING:
                raise ValueError(f"{name!r} must have a unit quaternion (xyzw)")
        if len({len(component.mean) for component in self.components}) != 1:
            raise ValueError("'components' must be one or more, all of the same size")
        if abs(sum(component.weight for component in self.components) - 1.0) > _ROUNDING:
            raise ValueError("the weights of 'components' must add up to 1")

    @property
    def has_base(self) -> bool:
        """Whether the base was learned along with the hand."""
        return len(self.components[0].mean) == SIZE_WITH_BASE


def shipped_models(kind: Kind | None = None) -> list[str]:
    """Return the sorted names of the models that are installed with the generators.

    Args:
        kind: Only those that this motion generator follows; all by default.
    """
    paths = sorted(_FOLDER.glob("*.yaml"))
    return [one.stem for one in paths if kind in (None, strict_yaml.read(one).get("kind"))]


def read_model(name_or_path: str | None, kind: Kind) -> Model:
    """Return the shipped model of this name (`door_open`), or that of a file (`my/model.yaml`).

    Raises:
        KinfeasError: If there is no such model, it is of another kind, or its file is wrong.
    """
    if not isinstance(name_or_path, str | os.PathLike):
        shipped = ", ".join(shipped_models(kind)) or "none"
        raise KinfeasError(f"'model' must be the path of a file or a shipped one: {shipped}")
    path = _find(os.fspath(name_or_path), kind)
    model = config.load(Model, path)
    if model.kind != kind:
        raise KinfeasError(f"{path}: 'kind' must be {kind!r} here, not {model.kind!r}")
    return model


def write_model(model: Model, path: Path) -> None:
    """Write a YAML file that `read_model` reads back, to eight significant digits.

    Raises:
        KinfeasError: If the file cannot be written.
    """
    strict_yaml.write(config.to_mapping(model), path, compact=True)


def rounded(values: Array) -> Array:
    """Return numbers of any shape with no more digits than a file holds."""
    return np.array([float(f"{value:.{_DIGITS}g}") for value in values.flat]).reshape(values.shape)


def _find(name_or_path: str, kind: Kind) -> Path:
    if is_path(name_or_path):
        return Path(name_or_path)
    if name_or_path not in shipped_models():
        hint = no_such(name_or_path, shipped_models(kind))
        raise KinfeasError(f"unknown model {name_or_path!r}{hint}, or the path of a .yaml file")
    return _FOLDER / f"{name_or_path}.yaml"
