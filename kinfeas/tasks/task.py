"""The task protocol, sub-goals, and random starts of episodes."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeVar, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from kinfeas import config
from kinfeas.config import registry
from kinfeas.control.execution import Frame, SubgoalMotion
from kinfeas.control.targets import TargetStream
from kinfeas.core.backend import Grip
from kinfeas.core.checks import are_unit, check_array
from kinfeas.core.errors import KinfeasError, plugin_note
from kinfeas.core.motion import MotionGenerator
from kinfeas.core.quantities import Seconds
from kinfeas.core.solids import MOST_SOLIDS, Solids
from kinfeas.core.spatial import IDENTITY, Array, compose
from kinfeas.core.start import Start
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolver
from kinfeas.robots.robot import Robot

T = TypeVar("T")

_DRAWS, _ROUNDS = 16, 100  # configurations in a round, and rounds before an error
_ROUNDING = 1e-3  # by which a start may be beyond the joint limits, radians or metres


@dataclass(frozen=True)
class MotionSpec:
    """A motion generator by name."""

    generator: str = "linear"  # entry-point name in the group kinfeas.motion_generators
    parameters: dict[str, object] = field(default_factory=dict)  # its keyword parameters


@dataclass(frozen=True)
class Subgoal:
    """One motion of a task."""

    motion: MotionSpec = field(default_factory=MotionSpec)  # generator of the motion
    # frame that it moves: `ee`, or `tip` for the tool tip in the common gripper convention, with x
    # as the approach and y as the finger axis
    frame: Frame = "ee"
    # seconds that the EE rests after its arrival, while the base may move; none after the last one
    dwell: Seconds = 0.0
    grip: Grip | None = None  # gripper command after the arrival, in worlds with a gripper


class Task(Protocol):
    """Draws the episodes of training and evaluation.

    Attributes:
        name: Short name.
        subgoals: Motions of the EE one after the other, at least one.
    """

    @property
    def name(self) -> str: ...  # noqa: D102 - see above

    @property
    def subgoals(self) -> tuple[Subgoal, ...]: ...  # noqa: D102 - see above

    def sample(self, solver: IkSolver, rng: np.random.Generator) -> Start:
        """Return one random episode, its arrays without a leading axis: (7,), (j,), (sub-goals, 7).

        Args:
            solver: The robot's kinematics.
            rng: The only source of randomness, so that an episode is a function of its seed.
        """


def start_at_home(robot: Robot) -> Start:
    """Return the start at the origin with the arm at home, without leading axes or a target."""
    return Start(IDENTITY, robot.home["home"], IDENTITY[np.newaxis])


@runtime_checkable
class StagedTask(Task, Protocol):
    """A task that also places objects in the backend when it draws an episode."""

    def sample_in(self, row: int, solver: IkSolver, rng: np.random.Generator) -> Start:
        """Return one random episode, as `Task.sample` does, and prepare the robot's row for it."""

    def drawn(self, start: Start) -> tuple[str, dict[str, Array], Solids | None]:
        """Return the surroundings of the first robot that were drawn with a sampled episode.

        They are the name of a scene, empty for the floor alone; the world poses, shape (7,), of its
        objects that were moved, by name; and the solids that are not in the scene.
        """

    def task_done(
        self, row: int, joint_positions: Array, dt: float, *, reached: bool
    ) -> bool | None:
        """Return whether an ended episode met the success condition of its task; None without one.

        Args:
            row: Row of the episode.
            joint_positions: Arm joints of all rows, shape (n, j).
            dt: Control period in seconds.
            reached: Whether the episode reached its goal.
        """


@runtime_checkable
class StreamTask(Protocol):
    """A task whose targets move until the end of the episode.

    Attributes:
        seconds: Duration of an episode.
    """

    @property
    def seconds(self) -> float: ...  # noqa: D102 - see above

    def target_stream(self, solver: IkSolver) -> TargetStream:
        """Return the targets of the episodes of a loop."""


def sample_start(
    task: Task, solver: IkSolver, rng: np.random.Generator, row: int | None = None
) -> Start:
    """Return one random episode of a task and check it, since tasks may come from plugins.

    `row` is the robot whose objects a `StagedTask` places; None for no backend.
    """
    subject = f"task {task.name!r}"
    with plugin_note(subject):
        if row is not None and isinstance(task, StagedTask):
            start = task.sample_in(row, solver, rng)
        else:
            start = task.sample(solver, rng)
    shapes = {
        "base_pose": (7,),
        "joint_positions": (len(solver.robot.arm),),
        "target_poses": (len(task.subgoals), 7),
    }
    for name, shape in shapes.items():
        value: Any = getattr(start, name, None)
        check_array(value, shape, f"{subject}: sampled {name}")
        if name != "joint_positions" and not are_unit(value):
            raise KinfeasError(f"{subject}: sampled {name} has no unit quaternion")
    lower, upper = solver.robot.joint_limits
    beyond = np.maximum(lower - start.joint_positions, start.joint_positions - upper) > _ROUNDING
    if beyond.any():
        joint = solver.robot.arm[int(beyond.argmax())].name
        raise KinfeasError(f"{subject}: sampled joint_positions are beyond the limits of {joint}")
    if start.solids is not None:
        _check_solids(start.solids, f"{subject}: sampled solids")
    return start


def _check_solids(solids: Solids, what: str) -> None:
    places = np.shape(solids.cylinder)[-1]
    if places > MOST_SOLIDS:
        raise KinfeasError(f"{what}: {places} places; at most {MOST_SOLIDS} are allowed")
    for name, shape in (("pose", (3,)), ("size", (4,)), ("velocity", (2,)), ("span", ())):
        check_array(getattr(solids, name), (1, places, *shape), f"{what}.{name}")
    if solids.cylinder.shape != (1, places):
        raise KinfeasError(f"{what}.cylinder has shape {solids.cylinder.shape}, not {(1, places)}")
    if np.any(solids.size[..., :2] < 0.0) or np.any(solids.size[..., 3] < solids.size[..., 2]):
        raise KinfeasError(f"{what}.size has a negative extent")


def named(
    kind: type[T], name: str, defaults: Mapping[str, object], parameters: Mapping[str, object]
) -> T:
    """Return a task of a class by its name; `parameters` replace the `defaults`."""
    return config.from_mapping(kind, {"name": name, **defaults, **parameters}, name)


def target_stream(task: Task, solver: IkSolver) -> TargetStream | None:
    """Return the moving targets of a `StreamTask`; None for other tasks."""
    return task.target_stream(solver) if isinstance(task, StreamTask) else None


def build_subgoals(subgoals: Sequence[Subgoal]) -> tuple[SubgoalMotion, ...]:
    """Return sub-goals with their generators; those of equal motions share one."""
    built: list[SubgoalMotion] = []
    for number, subgoal in enumerate(subgoals):
        motion = subgoal.motion
        equal = [b for a, b in zip(subgoals, built, strict=False) if a.motion == motion]
        where = f"subgoals.{number}.motion" if len(subgoals) > 1 else "motion"
        generator = equal[0].generator if equal else _build(motion, where)
        rest = subgoal.frame, subgoal.dwell, subgoal.grip, motion.generator
        built.append(SubgoalMotion(generator, *rest))
    return tuple(built)


def _build(motion: MotionSpec, where: str) -> MotionGenerator:
    try:
        return registry.build("kinfeas.motion_generators", motion.generator, motion.parameters)
    except KinfeasError as error:
        raise KinfeasError(f"'{where}': {error}") from error


def random_arm(
    solver: IkSolver,
    rng: np.random.Generator,
    accept: Callable[[Array], NDArray[np.bool_]] | None = None,
    *,
    either: bool = False,
) -> Array:
    """Return arm joints drawn uniformly within the limits, shape (j,), tool tip above the floor.

    They are admissible for `IkSolver`, and `accept` is true for their EE poses in the base frame,
    (n, 7) -> (n,); with `either`, one of these two is enough.
    """
    robot = solver.robot
    lower, upper = robot.finite_joint_limits
    tip = np.concatenate([robot.tool_tip, [0.0, 0.0, 0.0, 1.0]])
    for _ in range(_ROUNDS):
        joints = rng.uniform(lower, upper, (_DRAWS, len(lower)))
        ee = forward(solver.chain, joints)
        good = compose(ee, tip)[:, 2] > 0.0
        accepted = np.ones(_DRAWS, dtype=np.bool_) if accept is None else accept(ee)
        for row in np.flatnonzero(good if either else good & accepted):
            if (either and accepted[row]) or solver.admissible(joints[row]):
                return joints[row]
    raise KinfeasError(
        f"robot {robot.name!r}: {_DRAWS * _ROUNDS} draws have no arm configuration without "
        "self-collision and with the EE in the task's range; check joint limits, ignored "
        "collisions, heights and max_gravity_load"
    )
