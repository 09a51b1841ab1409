"""Tasks from YAML: a chain of motions to places that are drawn anew for each episode."""

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from scipy.spatial.transform import Rotation

from kinfeas import config
from kinfeas.config import Interval, strict_yaml
from kinfeas.config.quantities import Distance, Metres, Position, Radians
from kinfeas.core.errors import KinfeasError, check_name, no_such
from kinfeas.core.spatial import IDENTITY, Array, compose, make_pose, planar_pose
from kinfeas.core.start import Start
from kinfeas.kinematics.ik import IkSolver
from kinfeas.tasks.arm_start import random_arm
from kinfeas.tasks.scene import TaskScene
from kinfeas.tasks.task import Subgoal

Length = Metres | tuple[Metres, Metres]
"""A number, or the lowest and the highest to draw from uniformly."""

Angle = Radians | tuple[Radians, Radians]
"""The same in radians."""


@dataclass(frozen=True)
class Place:
    """A world pose, drawn once for each episode.

    Attributes:
        position: Metres.
        rpy: Roll, pitch and yaw about the world's x, y and z axes, one after the other, radians.
    """

    position: tuple[Length, Length, Length]
    rpy: tuple[Angle, Angle, Angle] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        """Check that the ranges ascend."""
        for name, numbers in (("position", self.position), ("rpy", self.rpy)):
            for number in numbers:
                if isinstance(number, tuple) and number[0] > number[1]:
                    raise ValueError(
                        f"{name!r} must not descend from {number[0]:g} to {number[1]:g}"
                    )

    def draw(self, rng: np.random.Generator) -> Array:
        """Return a pose, shape (7,)."""
        position = np.array([_draw(number, rng) for number in self.position])
        return make_pose(
            position, Rotation.from_euler("xyz", [_draw(number, rng) for number in self.rpy])
        )


@dataclass(frozen=True)
class BaseStart:
    """Where the base begins.

    Attributes:
        square: Side of the square around the origin that it is drawn from, metres.
        heading: How far it may be turned away from the first sub-goal's target, radians.
    """

    square: Distance = 1.5
    heading: Annotated[float, Interval(low=0.0, high=float(np.pi))] = float(np.pi / 2.0)


@dataclass(frozen=True, kw_only=True)
class ChainSubgoal(Subgoal):
    """One motion of a chain, and where it leads.

    Attributes:
        place: Name of a place.
        offset: From there to the motion's target, along the place's own axes, metres.
    """

    place: str
    offset: Position = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class ChainTask:
    """Move along a chain of sub-goals, from a random arm configuration.

    Attributes:
        name: Task name.
        subgoals: The motions, at least one.
        places: What they lead to, by name.
        start: Where the base begins.
        scene: What happens to objects, in worlds that have them.
    """

    name: str
    subgoals: tuple[ChainSubgoal, ...]
    places: dict[str, Place]
    start: BaseStart = field(default_factory=BaseStart)
    scene: TaskScene | None = None

    def __post_init__(self) -> None:
        """Check the name, and that the sub-goals lead to places that there are."""
        check_name(self.name)
        if not self.subgoals:
            raise ValueError("'subgoals' must have at least one entry")
        for number, subgoal in enumerate(self.subgoals):
            if subgoal.place not in self.places:
                known = no_such(subgoal.place, self.places)
                raise ValueError(
                    f"'subgoals.{number}.place': unknown place {subgoal.place!r}{known}"
                )
        reached = {subgoal.place for subgoal in self.subgoals}
        for name, move in self.scene.moves.items() if self.scene else ():
            if move.place not in reached:
                known = no_such(move.place, reached)
                raise ValueError(
                    f"'scene.moves.{name}.place': no sub-goal leads to {move.place!r}{known}"
                )

    def sample(self, solver: IkSolver, rng: np.random.Generator) -> Start:
        """Return one random episode, its arrays without a leading axis."""
        places = {name: place.draw(rng) for name, place in self.places.items()}
        targets = np.stack(
            [_shifted(places[subgoal.place], subgoal.offset) for subgoal in self.subgoals]
        )
        return self.toward(targets, solver, rng)

    def toward(self, targets: Array, solver: IkSolver, rng: np.random.Generator) -> Start:
        """Return a random start of an episode that leads to `targets`, shape (sub-goals, 7)."""
        x, y = rng.uniform(-self.start.square / 2.0, self.start.square / 2.0, 2)
        bearing = np.arctan2(targets[0, 1] - y, targets[0, 0] - x)
        heading = bearing + rng.uniform(-self.start.heading, self.start.heading)
        return Start(planar_pose(x, y, heading), random_arm(solver, rng), targets)

    def object_poses(self, targets: Array) -> dict[str, Array]:
        """Return where the objects stand that an episode moves, shape (7,), by their names.

        Args:
            targets: What the sub-goals of the episode lead to, shape (sub-goals, 7).
        """
        if self.scene is None:
            return {}
        places = {
            subgoal.place: _shifted(target, _minus(subgoal.offset))
            for subgoal, target in zip(self.subgoals, targets, strict=True)
        }
        return {name: move.carry(places[move.place]) for name, move in self.scene.moves.items()}


def read_chain(path: Path, changes: Mapping[str, object] | None = None) -> ChainTask:
    """Return the task that a YAML file describes.

    Files that it names are looked for beside it, and else from where the program runs.

    Args:
        path: File with the fields of `ChainTask`.
        changes: What to take instead of the file's entries; a mapping changes its own keys only,
            in place of a list the entries that it names by index.

    Raises:
        KinfeasError: If the file is broken, an entry or a change is not what `ChainTask` allows, or
            one of them gives a place that no sub-goal leads to.
    """
    data = {key: _located(entry, path.parent) for key, entry in strict_yaml.read(path).items()}
    task = config.from_mapping(ChainTask, data, str(path))
    _check_reached(task, task.places, str(path))
    if not changes:
        return task
    # The file is in order: what is wrong from here on is not its fault.
    source = "the task's parameters"
    changed = config.from_mapping(ChainTask, _changed(data, changes, source), source)
    # Other sub-goals may leave out some of the file's places, but not of those that are given.
    given = changes.get("places")
    _check_reached(changed, given if isinstance(given, Mapping) else (), source)
    return changed


def pick_place(**parameters: object) -> ChainTask:
    """Fetch an object from one table and put it down on another."""
    return _shipped("pick_place", parameters)


def door(**parameters: object) -> ChainTask:
    """Take the handle of a cupboard's door and open it."""
    return _shipped("door", parameters)


def drawer(**parameters: object) -> ChainTask:
    """Take the handle of a drawer and pull it open."""
    return _shipped("drawer", parameters)


def _shipped(name: str, parameters: Mapping[str, object]) -> ChainTask:
    return read_chain(Path(__file__).parent / f"{name}.yaml", parameters)


def _check_reached(task: ChainTask, given: Iterable[str], source: str) -> None:
    """Raise if no sub-goal leads to one of the places `given`: its name is misspelt."""
    reached = {subgoal.place for subgoal in task.subgoals}
    for name in given:
        if name not in reached:
            known = no_such(name, reached)
            raise KinfeasError(f"{source}: 'places.{name}': no sub-goal leads to {name!r}{known}")


def _changed(old: object, change: object, source: str) -> Any:
    """Return `old` with a `change`: mapping within mapping, and of a list the entries named."""
    if not isinstance(change, Mapping):
        return change
    if isinstance(old, list):
        new = list(old)
        for key, value in change.items():
            i = config.index_in(old, key, source)
            new[i] = _changed(old[i], value, source)
        return new
    if not isinstance(old, Mapping):
        return change
    if change.get("generator", old.get("generator")) != old.get("generator"):
        return change  # parameters belong to the generator that they were written for
    changes = {key: _changed(old.get(key), one, source) for key, one in change.items()}
    return {**old, **changes}


def _located(entry: object, folder: Path) -> object:
    """Return an entry with the names of files that lie in a folder, within it, as their paths."""
    if isinstance(entry, Mapping):
        return {key: _located(value, folder) for key, value in entry.items()}
    if isinstance(entry, list):
        return [_located(value, folder) for value in entry]
    if isinstance(entry, str) and Path(entry).suffix:
        path = str(folder / entry)
        # Path.is_file raises if a name is too long.
        return path if os.path.isfile(path) else entry  # noqa: PTH113
    return entry


def _draw(number: float | tuple[float, float], rng: np.random.Generator) -> float:
    return float(rng.uniform(*number)) if isinstance(number, tuple) else number


def _minus(offset: tuple[float, float, float]) -> tuple[float, float, float]:
    x, y, z = offset
    return -x, -y, -z


def _shifted(place: Array, offset: tuple[float, float, float]) -> Array:
    """Return the pose `offset` away from `place`, along its own axes, shape (7,)."""
    return compose(place, np.concatenate([offset, IDENTITY[3:]]))
