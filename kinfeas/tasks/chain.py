"""Tasks from YAML: chains of sub-goals at places that are drawn anew for each episode."""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Annotated

import numpy as np
from annotated_types import Interval
from scipy.spatial.transform import Rotation

from kinfeas.core.errors import KinfeasError, check_ascending, check_name, no_such
from kinfeas.core.quantities import Distance, Metres, Position, Radians
from kinfeas.core.solids import MOST_SOLIDS, Solids
from kinfeas.core.spatial import Array, compose, make_pose, planar_pose
from kinfeas.core.start import Start
from kinfeas.kinematics.ik import IkSolver
from kinfeas.kinematics.solids import collides
from kinfeas.scenes.objects import free_joints, moving_joint
from kinfeas.scenes.scene import Scene, furniture_solids, read_scene
from kinfeas.tasks.clutter import all_reachable, with_clutter
from kinfeas.tasks.task import Subgoal, random_arm

Length = Metres | tuple[Metres, Metres]  # metres, or the ends of a range to draw from uniformly

Angle = Radians | tuple[Radians, Radians]  # radians, or the ends of a range to draw from uniformly

_ROUNDS = 200  # draws of an episode or of a start before an error
_scene = lru_cache(maxsize=16)(read_scene)


@dataclass(frozen=True)
class Place:
    """A world pose, drawn once for each episode."""

    position: tuple[Length, Length, Length]  # metres
    # roll, pitch and yaw about the world's x, y and z axes, one after the other, radians
    rpy: tuple[Angle, Angle, Angle] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        for name, numbers in (("position", self.position), ("rpy", self.rpy)):
            for number in numbers:
                if isinstance(number, tuple):
                    check_ascending(name, number)

    def draw(self, rng: np.random.Generator) -> Array:
        """Return a pose, shape (7,)."""
        position = np.array([_draw(number, rng) for number in self.position])
        return make_pose(
            position, Rotation.from_euler("xyz", [_draw(number, rng) for number in self.rpy])
        )


@dataclass(frozen=True)
class BaseStart:
    """Start of the base."""

    # side of the square around the origin from which the position is drawn, metres
    square: Distance = 1.5
    # largest angle between the heading and the direction to the first target, radians
    heading: Annotated[float, Interval(ge=0.0, le=float(np.pi))] = float(np.pi / 2.0)


@dataclass(frozen=True, kw_only=True)
class ChainSubgoal(Subgoal):
    """One motion of a chain, and its target."""

    place: str  # name of a place, or of a handle of the scene
    # from there to the motion's target, along the place's own axes, metres
    offset: Position = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class ObjectMove:
    """Pose of an object in an episode."""

    place: str  # name of the place of a sub-goal
    # from there to the object, along the place's own axes, metres
    offset: Position = (0.0, 0.0, 0.0)
    turn: Radians = 0.0  # of the object about the place's z axis, radians


@dataclass(frozen=True)
class GraspedObject:
    """The object that the gripper grasps."""

    object: str  # name of an object of the scene
    link: str  # its link
    revolute: bool = False  # whether the link can turn in the gripper, as a bar can


@dataclass(frozen=True)
class SuccessCondition:
    """Success of a task: an object on another one, or one of its joints open."""

    object: str  # name of an object of the scene
    parent: str | None = None  # name of the object below it
    joint: str | None = None  # its joint
    # position beyond which the joint is open, rad or m; downwards if below 0
    threshold: float = 0.0
    reached: bool = False  # whether the EE must have reached its last goal, too

    def __post_init__(self) -> None:
        if (self.parent is None) == (self.joint is None):
            raise ValueError("one of 'parent' and 'joint' must be given, and not both")


@dataclass(frozen=True)
class TaskScene:
    """Objects of a task, in worlds that have them."""

    name: str  # the scene, by its name or the path of its YAML
    success: SuccessCondition | None = None  # of the task; by default there is none
    grasped_object: GraspedObject | None = None  # object that the gripper grasps; none by default
    # poses of objects that an episode moves, by their names
    moves: dict[str, ObjectMove] = field(default_factory=dict)


@dataclass(frozen=True)
class ChainTask:
    """Move along a chain of sub-goals, from a random arm configuration."""

    name: str  # task name
    subgoals: tuple[ChainSubgoal, ...]  # the motions, at least one
    # their targets, by name, beside the handles of the scene
    places: dict[str, Place] = field(default_factory=dict)
    start: BaseStart = field(default_factory=BaseStart)  # start of the base
    scene: TaskScene | None = None  # objects, in worlds that have them
    # largest number of random solids on the floor, beside solid furniture; None for neither
    clutter: Annotated[int, Interval(ge=0, le=MOST_SOLIDS)] | None = None

    def __post_init__(self) -> None:
        check_name(self.name)
        if not self.subgoals:
            raise ValueError("'subgoals' must have at least one entry")
        places = {*self.places}
        if self.scene is not None:
            scene = _scene(self.scene.name)
            check_scene(self.scene, scene)
            places |= scene.handles.keys()
        for number, subgoal in enumerate(self.subgoals):
            if subgoal.place not in places:
                hint = no_such(subgoal.place, places)
                raise ValueError(
                    f"'subgoals.{number}.place': unknown place {subgoal.place!r}{hint}"
                )
        for name, move in self.scene.moves.items() if self.scene else ():
            self.check_used(move.place, f"scene.moves.{name}.place")
        if self.scene is not None:
            self._check_grips(self.scene, scene)

    def _check_grips(self, task_scene: TaskScene, scene: Scene) -> None:
        """Raise ValueError if the gripper closes at an object or link that it does not grasp."""
        handles = {name: scene.handles[name] for name in scene.handles.keys() - self.places.keys()}
        grasped = task_scene.grasped_object
        link = grasped and scene.objects[grasped.object].urdf.rigid[grasped.link]
        for number, subgoal in enumerate(self.subgoals):
            if subgoal.grip != "close":
                continue
            moves = task_scene.moves.items()
            at = {name: link for name, move in moves if move.place == subgoal.place}
            if handle := handles.get(subgoal.place):
                at = {handle.object: scene.objects[handle.object].urdf.rigid[handle.link]}
            if at and (grasped is None or at.get(grasped.object) != link):
                only = "nothing" if grasped is None else f"{grasped.link} of {grasped.object}"
                raise ValueError(
                    f"'subgoals.{number}.grip': the gripper grasps {only} "
                    f"('scene.grasped_object'), not {subgoal.place!r} of {' or '.join(at)}"
                )

    def check_used(self, place: str, key: str) -> None:
        """Raise ValueError about `key` if no sub-goal has the place."""
        used = {subgoal.place for subgoal in self.subgoals}
        if place not in used & self.places.keys():
            known = used if place in self.places else used & self.places.keys()
            raise ValueError(f"{key!r}: no sub-goal has the place {place!r}{no_such(place, known)}")

    def sample(self, solver: IkSolver, rng: np.random.Generator) -> Start:
        """Return one random episode, its arrays without a leading axis."""
        for _ in range(_ROUNDS):
            places = {name: place.draw(rng) for name, place in self.places.items()}
            places |= self._handle_poses(places)
            targets = np.stack(
                [_shifted(places[subgoal.place], subgoal.offset) for subgoal in self.subgoals]
            )
            if self.clutter is None:
                return self.toward(targets, solver, rng)
            furniture = self.furniture(targets)
            start = self.toward(targets, solver, rng, furniture)
            solids = with_clutter(solver, start, furniture, self.clutter, rng)
            if all_reachable(solver, start, solids):
                return replace(start, solids=solids)
        raise KinfeasError(f"task {self.name!r}: {_ROUNDS} draws left no room for the base")

    def toward(
        self,
        targets: Array,
        solver: IkSolver,
        rng: np.random.Generator,
        solids: Solids | None = None,
    ) -> Start:
        """Return a random start for `targets`, (sub-goals, 7); the robot touches no solid."""
        for _ in range(_ROUNDS):
            x, y = rng.uniform(-self.start.square / 2.0, self.start.square / 2.0, 2)
            bearing = np.arctan2(targets[0, 1] - y, targets[0, 0] - x)
            heading = bearing + rng.uniform(-self.start.heading, self.start.heading)
            base, joints = planar_pose(x, y, heading), random_arm(solver, rng)
            if solids is None:
                return Start(base, joints, targets)
            rows = joints[np.newaxis], base[np.newaxis], solids
            if not collides(solver.collision, *rows).any():
                return Start(base, joints, targets, solids)
        raise KinfeasError(f"task {self.name!r}: the robot touches a solid in {_ROUNDS} starts")

    def furniture(self, targets: Array) -> Solids:
        """Return the furniture of the episode with the `targets`, shape (sub-goals, 7), as solids.

        Objects that the gripper moves are left out.
        """
        scene = self.scene_with(targets)
        return Solids.empty(1) if scene is None else self.solids_of(scene)

    def scene_with(self, targets: Array) -> Scene | None:
        """Return the scene of the episode with the `targets`, shape (sub-goals, 7), if any."""
        if self.scene is None:
            return None
        return _scene(self.scene.name).with_poses(self.object_poses(targets))

    def solids_of(self, scene: Scene) -> Solids:
        """Return the furniture of a scene as one row of solids, without grasped links."""
        grasped = self.scene.grasped_object if self.scene else None
        return furniture_solids(scene, (grasped.object, grasped.link) if grasped else None)

    def object_poses(self, targets: Array) -> dict[str, Array]:
        """Return the world poses, shape (7,), of the objects that an episode moves, by name.

        The episode has the `targets`, shape (sub-goals, 7).
        """
        if self.scene is None:
            return {}
        places = {
            subgoal.place: _shifted(target, tuple(-x for x in subgoal.offset))
            for subgoal, target in zip(self.subgoals, targets, strict=True)
        }
        return self._moved(self.scene, places)

    def _handle_poses(self, places: Mapping[str, Array]) -> dict[str, Array]:
        names = {subgoal.place for subgoal in self.subgoals} - places.keys()
        if self.scene is None or not names:
            return {}
        scene = _scene(self.scene.name).with_poses(self._moved(self.scene, places))
        return {name: scene.handle_pose(name) for name in names}

    @staticmethod
    def _moved(scene: TaskScene, places: Mapping[str, Array]) -> dict[str, Array]:
        return {
            name: _shifted(places[move.place], move.offset, move.turn)
            for name, move in scene.moves.items()
        }


def check_scene(task_scene: TaskScene, scene: Scene) -> None:
    """Raise ValueError if objects, links or joints of a task are missing or do not fit."""
    objects = scene.objects

    def need(key: str, word: str, names: Collection[str], what: str) -> None:
        if word not in names:
            raise ValueError(f"'scene.{key}': no {what} {word!r}{no_such(word, names)}")

    for moved in task_scene.moves:
        need(f"moves.{moved}", moved, objects, "object")
    if (grasped := task_scene.grasped_object) is not None:
        need("grasped_object.object", grasped.object, objects, "object")
        grasped_object = objects[grasped.object]
        need("grasped_object.link", grasped.link, grasped_object.urdf.links, "link")
        if grasped_object.fixed and moving_joint(grasped_object.urdf, grasped.link) is None:
            raise ValueError(
                f"'scene.grasped_object': link {grasped.link!r} of the fixed object "
                f"{grasped.object!r} is below no moving joint"
            )
    if (success := task_scene.success) is None:
        return
    need("success.object", success.object, objects, "object")
    if success.parent is not None:
        others = [name for name in objects if name != success.object]
        need("success.parent", success.parent, others, "other object")
    if success.joint is not None:
        joints = free_joints(objects[success.object].urdf)
        need("success.joint", success.joint, joints, "moving joint")
        low, high, at = joints[success.joint].lower, joints[success.joint].upper, success.threshold
        if not (low < at if at < 0.0 else at < high):
            raise ValueError(
                f"'scene.success.threshold' must be between the limits of joint "
                f"{success.joint!r}, {low:g} and {high:g}, not {at:g}"
            )


def _draw(number: float | tuple[float, float], rng: np.random.Generator) -> float:
    return float(rng.uniform(*number)) if isinstance(number, tuple) else number


def _shifted(place: Array, offset: Iterable[float], yaw: float = 0.0) -> Array:
    """Return the pose `offset` away from `place` along its axes and turned about its z, (7,)."""
    return compose(place, make_pose(np.array([*offset]), Rotation.from_rotvec([0.0, 0.0, yaw])))
