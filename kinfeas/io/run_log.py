"""Run logs: CSV files with a JSON header, written line by line, readable even after a kill."""

import csv
import json
import logging
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, TextIO

import numpy as np
from annotated_types import Len
from numpy.typing import NDArray

from kinfeas import config
from kinfeas.core.errors import KinfeasError, plugin_note
from kinfeas.core.files import reading, writing
from kinfeas.core.quantities import NotNegative, Positive
from kinfeas.core.spatial import POSE_COLUMNS, Array

REACHED = "goal reached"
"""Last event of a successful run; an entry of `TASK_DONE` may follow."""

TASK_DONE = {True: ", task done", False: ", task not done", None: ""}
"""End of the last event by task success; None for tasks without objects."""

_FORMAT = "kinfeas record 1"
_ARRAYS = "base_pose", "joint_positions", "desired", "goal", "base_twist", "joint_targets"
_log = logging.getLogger(__name__)
_TWIST = ("vx", "vy", "vz", "wx", "wy", "wz")


@dataclass(frozen=True)
class About:
    """Header of a run log."""

    robot: str  # name of the robot, or the absolute path of its YAML
    task: str  # name of the task
    policy: str  # name of the policy
    backend: str  # name of the backend
    dt: Positive  # control period in seconds
    joints: tuple[str, ...]  # names of the arm joints, at least one
    started: str  # date and time of the start, with time zone
    scene: str = ""  # scene of the task by name or absolute path; empty for the floor alone
    # world poses of the objects moved at the start of the episode, by name
    objects: dict[str, tuple[float, ...]] = field(default_factory=dict)
    # solids at the start, as in `Solids.table`
    solids: tuple[Annotated[tuple[float, ...], Len(11, 11)], ...] = ()
    seed: int | None = None  # seed of the run; None if unknown, as in old records
    adapters: tuple[config.PluginSpec, ...] = ()  # around the backend, the first one innermost
    filters: tuple[config.PluginSpec, ...] = ()  # command filters in order
    generators: tuple[config.PluginSpec, ...] = ()  # motion generator of each sub-goal
    # limits by name, as in `kinfeas.sim2real.deploy.config.Guards`; null for none
    guards: dict[str, object] = field(default_factory=dict)
    arm_seconds: NotNegative = 0.0  # as in `kinfeas.core.backend.Backend`


@dataclass(frozen=True, eq=False)
class Moment:
    """A line of a run log: the command of a control period and the measurement after it.

    The last line is the stop, or the control period whose measurement stopped the run; invalid
    measurements are NaN.
    """

    time: float  # seconds since the start
    age: float  # age of the measurement in seconds; NaN if unknown
    base_pose: Array  # measured world pose of the base, shape (7,)
    joint_positions: Array  # measured arm joints, shape (j,)
    desired: Array  # desired world pose of the EE, shape (7,)
    goal: Array  # world pose of the EE at the end of the sub-goal, shape (7,)
    # commanded world twist, (6,), m/s and rad/s, and arm joints, (j,): as sent or, with adapters in
    # between, as given to the outermost one
    base_twist: Array
    joint_targets: Array
    feasible: bool  # whether IK found the desired pose
    subgoal: int  # number of the sub-goal
    event: str = ""  # event of the period; empty if none


@dataclass(frozen=True, eq=False)
class Record:
    """A run log: the fields of `Moment`, each with a leading axis of t lines."""

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

    @property
    def later(self) -> NDArray[np.bool_]:
        """Whether each line is later than the line before, and not the end of a run, shape (t,).

        The last line of a run has no command, or a measurement that stopped the run.
        """
        later = np.diff(self.time, prepend=-np.inf) > 0.0
        later[1:][-1:] &= not self.event[-1]
        return later


class Recorder:
    """A context manager that writes a run log, line by line, to `path`.

    The file is removed if no line was written.
    """

    def __init__(
        self, path: Path, about: About, on_moment: Callable[[Moment], None] | None = None
    ) -> None:
        """Begin a file; raise KinfeasError if it exists or cannot be written.

        `on_moment` is called with each line.
        """
        self.path, self._begun, self._on_moment = path, False, on_moment
        with writing(path):
            self._file: TextIO = path.open("x", encoding="utf-8", newline="", buffering=1)
            self._rows = csv.writer(self._file, lineterminator="\n")
            try:
                self._file.write(f"# {_FORMAT} {json.dumps(asdict(about), default=str)}\n")
                self._rows.writerow(_names(about.joints))
            except OSError:
                self._end()
                raise

    def __enter__(self) -> "Recorder":
        return self

    def __exit__(self, *_: object) -> None:
        self._end()

    def write(self, moment: Moment) -> None:
        """Append a line; raise KinfeasError if it cannot be written."""
        numbers = [f"{value:.9g}" for name in _ARRAYS for value in getattr(moment, name).tolist()]
        age = "" if np.isnan(moment.age) else f"{moment.age:.4f}"
        rest = [str(int(moment.feasible)), str(moment.subgoal), " ".join(moment.event.split())]
        with writing(self.path):
            self._rows.writerow([f"{moment.time:.4f}", age, *numbers, *rest])
        self._begun = True
        if self._on_moment is not None:
            with plugin_note("on_moment"):  # errors are not those of a backend that calls this
                self._on_moment(moment)

    def _end(self) -> None:
        with suppress(OSError):  # `write` has already raised for a full disk
            self._file.close()
        if not self._begun:
            self.path.unlink(missing_ok=True)


def is_record(path: Path) -> bool:
    """Return whether a file begins as a run log of any version."""
    begin = f"# {_FORMAT.rsplit(maxsplit=1)[0]} ".encode()
    with path.open("rb") as file:
        return file.read(len(begin)) == begin


def read_record(path: Path) -> Record:
    """Return a run log, without an incomplete last line; raise KinfeasError if it is invalid."""
    with reading(path):
        text = path.read_text(encoding="utf-8")
    head, *lines = text[: text.rfind("\n") + 1].splitlines() or [""]
    about = _about(head, path)
    names, rows = _names(about.joints), list(csv.reader(lines))
    if rows[:1] != [names]:
        raise KinfeasError(f"{path}, line 2: not the columns of a run log of {about.robot!r}")
    if len(rows) < 2:
        raise KinfeasError(f"{path}: the run ended before its first step")
    numbers = np.empty((len(rows) - 1, len(names) - 1))
    optional = np.array([name == "age" for name in names[:-1]])
    measured = np.array([name.startswith(("age", "base.", "joint.")) for name in names[:-1]])
    for i, row in enumerate(rows[1:]):
        try:
            if len(row) != len(names):
                raise ValueError(f"{len(row)} columns, not {len(names)}")
            numbers[i] = [float(entry or "nan") for entry in row[:-1]]
            missing = measured if i == len(numbers) - 1 else optional  # may be NaN
            wrong = ~np.isfinite(numbers[i]) & ~(missing & np.isnan(numbers[i]))
            for k in np.flatnonzero(wrong):
                raise ValueError(f"{names[k]!r} is not finite")
        except ValueError as error:
            raise KinfeasError(f"{path}, line {i + 3}: {error}") from error
    if not text.endswith("\n"):
        _log.warning("%s: its last line is cut, and left out", path)
    j = len(about.joints)
    time, age, *blocks, feasible, subgoal = np.split(
        numbers, np.cumsum([1, 1, 7, j, 7, 7, 6, j, 1]), axis=1
    )
    return Record(
        about=about,
        time=time[:, 0],
        age=age[:, 0],
        **dict(zip(_ARRAYS, blocks, strict=True)),
        feasible=feasible[:, 0] > 0.0,
        subgoal=subgoal[:, 0].astype(np.intp),
        event=tuple(row[-1] for row in rows[1:]),
    )


def _about(line: str, path: Path) -> About:
    mark = f"# {_FORMAT} "
    if not line.startswith(mark):
        raise KinfeasError(f"{path}: not a run log: it does not begin with {mark.strip()!r}")
    try:
        data = json.loads(line.removeprefix(mark))
    except (ValueError, RecursionError) as error:
        raise KinfeasError(f"{path}, line 1: broken JSON: {error}") from error
    about = config.from_mapping(About, data, f"{path}, line 1")
    if not about.joints:
        raise KinfeasError(f"{path}, line 1: 'joints' must name one joint at least")
    return about


def _names(joints: Sequence[str]) -> list[str]:
    groups = {
        "base": POSE_COLUMNS, "joint": joints, "desired": POSE_COLUMNS, "goal": POSE_COLUMNS,
        "command": _TWIST, "target": joints,
    }  # fmt: skip
    names = [f"{group}.{name}" for group, members in groups.items() for name in members]
    return ["time", "age", *names, "feasible", "subgoal", "event"]
