"""What a policy file says of itself, in the metadata of the ONNX file.

Each field of `About` is one entry, `kinfeas.FIELD`, whose value is JSON. Beside them stand
`kinfeas.schema`, the version of all this, and `kinfeas.digest`, the hash of everything else.
"""

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from kinfeas import config
from kinfeas.control.drive import action_size
from kinfeas.control.observation import FIELDS, HORIZON
from kinfeas.core.errors import KinfeasError
from kinfeas.policies.onnx_bytes import content, entries, fields, text
from kinfeas.robots.fingerprint import fingerprint
from kinfeas.robots.robot import Robot

SCHEMA = 1
"""Version of the metadata and of the graph; any other is refused."""

PREFIX, DIGEST, METADATA_FIELD = "kinfeas.", "kinfeas.digest", 14

_QUATERNION = "quaternion x y z w, w >= 0"
_UNITS = {
    "ee_position": "m",
    "ee_orientation": _QUATERNION,
    "planned_velocity": "m/s",
    "planned_rotation": f"{_QUATERNION}, over {HORIZON:g} s",
    "goal_position": "m",
    "goal_orientation": _QUATERNION,
}


@dataclass(frozen=True)
class RobotAbout:
    """Whom a policy drives.

    Attributes:
        name: Short name of the robot.
        kinematics: What `robots.fingerprint` says of it.
        ee_frame: Link whose pose is meant by EE pose.
        base_frame: Link in whose frame the policy observes.
        drive: `omnidirectional` or `differential`.
    """

    name: str
    kinematics: str
    ee_frame: str
    base_frame: str
    drive: str


@dataclass(frozen=True)
class Observed:
    """One field of the observation: its name, how many numbers it has, their frame and unit."""

    name: str
    size: int
    frame: str
    unit: str


@dataclass(frozen=True)
class Commanded:
    """One number of the action, in [-1, 1]: what `limit` times it is, in `unit`."""

    name: str
    unit: str
    limit: float


@dataclass(frozen=True)
class Control:
    """How often a policy acts.

    Attributes:
        period: Seconds between the actions it was trained with; None where that is not known.
        horizon: Seconds of planned motion that an observation shows, at any control rate.
    """

    period: float | None
    horizon: float


@dataclass(frozen=True)
class Golden:
    """Observations and the training policy's actions, one row each."""

    observation: tuple[tuple[float, ...], ...]
    action: tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class About:
    """What a policy file says of itself.

    Attributes:
        version: Of kinfeas, which wrote it.
        robot: Whom it drives.
        observation: What goes in, in this order.
        action: What comes out, in this order.
        control: How often it acts.
        training: Configuration, seed and steps of the training run.
        success: Figures of evaluations, by kind.
        golden: What it must answer.
    """

    version: str
    robot: RobotAbout
    observation: tuple[Observed, ...]
    action: tuple[Commanded, ...]
    control: Control
    training: dict[str, object]
    success: dict[str, object]
    golden: Golden

    @property
    def trained_with(self) -> str:
        """The robot by name or by path, as the training's settings have it."""
        settings = self.training.get("config")
        known = settings if isinstance(settings, dict) else {}
        return str(known.get("robot", self.robot.name))


def describe_robot(robot: Robot) -> RobotAbout:
    """Return what a policy file says of a robot."""
    base = robot.base
    return RobotAbout(robot.name, fingerprint(robot), robot.ee_frame, base.frame, base.drive)


def describe_observation(robot: Robot) -> tuple[Observed, ...]:
    """Return the fields of `observation.observe`: all but the joints in the base's frame."""
    seen = [Observed(name, size, robot.base.frame, _UNITS[name]) for name, size in FIELDS]
    for joint in robot.arm:
        unit = "m" if robot.urdf.joints[joint.name].kind == "prismatic" else "rad"
        unit += ", in (-pi, pi]" if joint.continuous else ""
        seen.append(Observed(joint.name, 1, "joint", unit))
    return tuple(seen)


def describe_action(robot: Robot) -> tuple[Commanded, ...]:
    """Return the numbers that `drive.base_twist` takes."""
    names = ("forward", "left") if action_size(robot.base) == 3 else ("forward",)
    driven = [Commanded(name, "m/s", robot.base.max_velocity) for name in names]
    return (*driven, Commanded("turn", "rad/s", robot.base.max_rotation))


def to_metadata(about: About) -> dict[str, str]:
    """Return the metadata that `from_metadata` reads back, without the digest.

    Settings that are no finite numbers become words, for JSON has no others.
    """
    entries = {"schema": SCHEMA, **config.to_mapping(about)}
    return {PREFIX + key: json.dumps(_worded(value)) for key, value in entries.items()}


def from_metadata(metadata: Mapping[str, str]) -> About:
    """Return what the metadata of a policy file says.

    Raises:
        KinfeasError: If an entry is missing, unknown, no JSON or not what it has to be.
    """
    own = {key.removeprefix(PREFIX): _json(key, value) for key, value in metadata.items()}
    plain = {key: value for key, value in own.items() if key not in ("schema", "digest")}
    return config.from_mapping(About, plain, "its metadata")


def read_metadata(model: bytes) -> dict[str, str]:
    """Return the metadata of an ONNX file as text by key, empty if there is none.

    Raises:
        KinfeasError: If the bytes are no ONNX file, or a key stands there twice.
    """
    found: dict[str, str] = {}
    for entry in entries(model):
        if entry.number == METADATA_FIELD:
            key, value = _pair(entry.value)
            if key in found:
                raise KinfeasError(f"its metadata has two entries {key!r}")
            found[key] = value
    return found


def check_schema(metadata: Mapping[str, str]) -> None:
    """Check that the metadata is of a policy file, and of a version that is read here.

    Raises:
        KinfeasError: If it is not.
    """
    found = metadata.get(f"{PREFIX}schema")
    if found is None:
        raise KinfeasError("not a policy that `kinfeas export` wrote: its metadata lacks a schema")
    if found != str(SCHEMA):
        writer = metadata.get(f"{PREFIX}version", "?")
        raise KinfeasError(
            f"its schema is {found[:20]!r}, written by kinfeas {writer[:20]!r}; "
            f"this version reads schema {SCHEMA}"
        )


def digest(model: bytes) -> str:
    """Return what the entry `kinfeas.digest` of an ONNX file has to be: a hash of all the rest."""
    found = hashlib.sha256()
    for entry in entries(model):
        if entry.number != METADATA_FIELD or _pair(entry.value)[0] != DIGEST:
            found.update(entry.raw)
    return json.dumps(f"sha256:{found.hexdigest()}")


def _pair(message: int | bytes) -> tuple[str, str]:
    pair = fields(content([message], "its metadata"), {1: "key", 2: "value"}, "metadata")
    return text(pair["key"], "a key"), text(pair["value"], "an entry of its metadata")


def _worded(value: object) -> object:
    """Return plain data with the words inf, -inf and nan in place of these numbers."""
    if isinstance(value, dict):
        return {key: _worded(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [_worded(inner) for inner in value]
    return value if not isinstance(value, float) or math.isfinite(value) else str(value)


def _json(key: str, value: str) -> Any:
    try:
        return json.loads(value, parse_constant=_finite, parse_float=_finite)
    except (ValueError, RecursionError) as error:
        raise KinfeasError(f"its metadata {key!r} is not JSON: {error}") from error


def _finite(word: str) -> float:
    if not math.isfinite(value := float(word)):
        raise ValueError(f"{word[:20]} is not finite")
    return value
