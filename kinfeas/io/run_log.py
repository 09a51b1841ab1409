"""The record of a run: a CSV file that is written line by line and outlives a kill in mid-line."""

import csv
import json
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from io import StringIO
from pathlib import Path
from typing import TextIO

import numpy as np
from numpy.typing import NDArray

from kinfeas import config
from kinfeas.config.quantities import REMOTEST, Positive
from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import Array
from kinfeas.io.files import reading, writing

REACHED = "goal reached"
"""The event that a run ends with if it did what it should; `TASK_DONE` may follow."""

TASK_DONE = {True: ", task done", False: ", task not done", None: ""}
"""How a run's last event ends; None for a task that moves no objects."""

_FORMAT = "kinfeas record 1"
_NOT_UNIT = 0.1  # how far the norm of a quaternion may be from 1: what was measured is written down
_POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")
_TWIST = ("vx", "vy", "vz", "wx", "wy", "wz")


@dataclass(frozen=True)
class About:
    """What a record is of.

    Attributes:
        robot: Name of the robot, or the absolute path of its YAML.
        task: What it was to do.
        policy: What drove its base.
        backend: What moved it.
        dt: Control period in seconds.
        joints: Names of the arm joints.
        started: Date and time of the start, with the time zone.
        scene: Scene of the task by name or absolute path; empty for a floor and nothing else.
        objects: World poses of the objects that the episode moved at its start, by name.
    """

    robot: str
    task: str
    policy: str
    backend: str
    dt: Positive
    joints: tuple[str, ...]
    started: str
    scene: str = ""
    objects: dict[str, tuple[float, ...]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Moment:
    """One line of a record: what was commanded for a control period and what came of it.

    Attributes:
        time: Seconds since the start.
        age: Of the measurement, seconds; NaN where it is not known.
        base_pose: Measured world pose of the base, shape (7,).
        joint_positions: Measured arm joints, shape (j,).
        desired: Desired world pose of the EE, shape (7,).
        goal: World pose of the EE at the end of the sub-goal, shape (7,).
        base_twist: World twist that was commanded, shape (6,), m/s and rad/s.
        joint_targets: Arm joints that were commanded, shape (j,).
        feasible: Whether IK found the desired pose.
        sub-goal: Number of the sub-goal.
        event: What happened, if anything did.
    """

    time: float
    age: float
    base_pose: Array
    joint_positions: Array
    desired: Array
    goal: Array
    base_twist: Array
    joint_targets: Array
    feasible: bool
    subgoal: int
    event: str = ""


@dataclass(frozen=True, eq=False)
class Record:
    """What a file holds: the columns of `Moment`, each with a leading axis of t lines."""

    about: About
    time: Array
    age: Array
    base_pose: Array
    joint_positions: Array
    desired: Array
    goal: Array
    base_twist: Array
    joint_targets: Array
    feasible: NDArray[np.bool_]
    subgoal: NDArray[np.intp]
    event: tuple[str, ...]


class Recorder:
    """Writes a record; to be used as a context. Each line is handed to the system at once.

    A run that has not begun leaves no file.

    Attributes:
        path: The file.
    """

    def __init__(self, path: Path, about: About) -> None:
        """Begin a file.

        Raises:
            KinfeasError: If there is one already, or it cannot be written.
        """
        self.path, self._begun = path, False
        with writing(path):
            self._file: TextIO = path.open("x", encoding="utf-8", newline="", buffering=1)
            try:
                self._file.write(
                    f"# {_FORMAT} {json.dumps(asdict(about))}\n{_header(about.joints)}"
                )
            except OSError:
                self._end()
                raise

    def __enter__(self) -> "Recorder":
        """Return the recorder."""
        return self

    def __exit__(self, *_: object) -> None:
        self._end()

    def write(self, moment: Moment) -> None:
        """Append a line.

        Raises:
            KinfeasError: If it cannot be written.
        """
        columns = (
            moment.base_pose,
            moment.joint_positions,
            moment.desired,
            moment.goal,
            moment.base_twist,
            moment.joint_targets,
        )
        numbers = [f"{value:.9g}" for column in columns for value in column.tolist()]
        age = "" if np.isnan(moment.age) else f"{moment.age:.4f}"
        event = " ".join(moment.event.split())
        rest = [str(int(moment.feasible)), str(moment.subgoal), event]
        with writing(self.path):
            self._file.write(_line([f"{moment.time:.4f}", age, *numbers, *rest]))
        self._begun = True

    def _end(self) -> None:
        """Close the file, and remove it if it holds nothing of a run."""
        with suppress(OSError):  # what a full disk did not take: `write` has raised for it
            self._file.close()
        if not self._begun:
            self.path.unlink(missing_ok=True)


def read_record(path: Path) -> Record:
    """Return what a file holds; a last line that was cut short is left out.

    Raises:
        KinfeasError: If it is no record, or a line is broken.
    """
    with reading(path):
        text = path.read_text(encoding="utf-8")
    whole = text[: text.rfind("\n") + 1].splitlines(keepends=True)
    about = _about(whole[0] if whole else "", path)
    if whole[1:2] != [_header(about.joints)]:
        raise KinfeasError(f"{path}, line 2: not the columns of a record of robot {about.robot!r}")
    if not whole[2:]:
        raise KinfeasError(f"{path}: the run ended before its first step")
    width = len(_names(about.joints))
    rows = [_row(line, width, f"{path}, line {n}") for n, line in enumerate(whole[2:], 3)]
    record = _record(about, np.array([numbers for numbers, _ in rows]), [text for _, text in rows])
    _check_quaternions(record, path)
    return record


def _check_quaternions(record: Record, path: Path) -> None:
    for name in ("base_pose", "desired", "goal"):
        norm = np.linalg.norm(getattr(record, name)[:, 3:], axis=1)
        for row in np.flatnonzero(np.abs(norm - 1.0) > _NOT_UNIT)[:1]:
            raise KinfeasError(f"{path}, line {row + 3}: {name} has no unit quaternion (xyzw)")


def _about(line: str, path: Path) -> About:
    mark = f"# {_FORMAT} "
    if not line.startswith(mark):
        raise KinfeasError(
            f"{path}: not the record of a run: it does not begin with {mark.strip()!r}"
        )
    place = f"{path}, line 1"
    try:
        data = json.loads(line.removeprefix(mark))
    except ValueError as error:
        raise KinfeasError(f"{place}: broken JSON: {error}") from error
    except RecursionError as error:
        raise KinfeasError(f"{place}: broken JSON: nested too deeply") from error
    about = config.from_mapping(About, data, place)
    if not about.joints:
        raise KinfeasError(f"{place}: 'joints' must name one joint at least")
    return about


def _names(joints: Sequence[str]) -> list[str]:
    """Return the names of all columns."""

    def group(prefix: str, names: Sequence[str]) -> list[str]:
        return [f"{prefix}.{name}" for name in names]

    return [
        "time", "age", *group("base", _POSE), *group("joint", joints), *group("desired", _POSE),
        *group("goal", _POSE), *group("command", _TWIST), *group("target", joints),
        "feasible", "subgoal", "event",
    ]  # fmt: skip


def _header(joints: Sequence[str]) -> str:
    return _line(_names(joints))


def _line(entries: Sequence[str]) -> str:
    text = StringIO()
    csv.writer(text, lineterminator="\n").writerow(entries)
    return text.getvalue()


def _row(line: str, width: int, place: str) -> tuple[list[float], str]:
    """Return the numbers of a line and its event."""
    try:
        entries = next(csv.reader([line], strict=True))
        numbers = [float(entry) for entry in entries[2:-1]]
        time, age = float(entries[0]), float(entries[1] or "nan")
    except (ValueError, IndexError, StopIteration, csv.Error) as error:
        raise KinfeasError(f"{place}: {error}") from error
    if len(entries) != width:
        raise KinfeasError(f"{place}: has {len(entries)} entries for {width} columns")
    if not np.isfinite([time, *numbers]).all():
        raise KinfeasError(f"{place}: holds a number that is not finite")
    if np.nanmax(np.abs([time, age, *numbers])) > REMOTEST:
        raise KinfeasError(f"{place}: holds a number beyond {REMOTEST:,.0f}, which nothing can be")
    if numbers[-2] not in (0.0, 1.0) or numbers[-1] < 0.0 or numbers[-1] % 1.0:
        raise KinfeasError(f"{place}: 'feasible' must be 0 or 1 and 'sub-goal' a whole number >= 0")
    return [time, age, *numbers], entries[-1]


def _record(about: About, numbers: Array, events: Sequence[str]) -> Record:
    j = len(about.joints)
    time, age, base, joints, desired, goal, twist, targets, feasible, subgoal = np.split(
        numbers, np.cumsum([1, 1, 7, j, 7, 7, 6, j, 1]), axis=1
    )
    return Record(
        about,
        time[:, 0],
        age[:, 0],
        base,
        joints,
        desired,
        goal,
        twist,
        targets,
        feasible[:, 0] > 0.0,
        subgoal[:, 0].astype(np.intp),
        tuple(events),
    )
