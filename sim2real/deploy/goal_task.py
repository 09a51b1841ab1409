"""The task of a single goal, and the start of a run."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from kinfeas.core import spatial
from kinfeas.core.backend import RobotState
from kinfeas.core.errors import KinfeasError
from kinfeas.core.quantities import REMOTEST
from kinfeas.core.solids import Solids
from kinfeas.core.spatial import Array
from kinfeas.core.start import Start, stacked
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolver
from kinfeas.tasks.chain import ChainTask
from kinfeas.tasks.task import MotionSpec, Subgoal, Task, sample_start


@dataclass(frozen=True, eq=False)
class GoalTask:
    """One motion of the EE to a given pose, by default from the origin with the arm at home."""

    goal: Array  # world position, shape (3,), metres
    orientation: Array | None = None  # unit quaternion xyzw, shape (4,); that of the start if None
    motion: MotionSpec = field(default_factory=MotionSpec)
    name: str = "goal"
    origin: tuple[Array, Array] | None = None  # base pose (7,) and arm joints (j,) of the start

    @property
    def subgoals(self) -> tuple[Subgoal, ...]:
        """The sub-goal of the EE frame."""
        return (Subgoal(self.motion),)

    def sample(self, solver: IkSolver, rng: np.random.Generator) -> Start:
        """Return the start, without leading axes."""
        base, joints = self.origin or (spatial.IDENTITY, solver.robot.home["home"])
        start = Start(base, joints, np.empty((1, 7)))
        return self.aimed(solver, start)

    def aimed(self, solver: IkSolver, start: Start) -> Start:
        """Return a start, without leading axes, with the goal as its target."""
        orientation = self.orientation
        if orientation is None:
            ee = forward(solver.chain, start.joint_positions[np.newaxis])
            orientation = spatial.compose(start.base_pose[np.newaxis], ee)[0, 3:]
        target = np.concatenate([self.goal, spatial.canonical(orientation)])
        return replace(start, target_poses=target[np.newaxis])


def make_goal_task(
    position: Sequence[float], orientation: Sequence[float] | None, motion: MotionSpec
) -> GoalTask:
    """Return the task of one goal: a world position in metres, and an orientation.

    The orientation is roll, pitch and yaw about the world's axes in radians, or a quaternion xyzw;
    None for that at the start. Raises KinfeasError if a number is not finite or too large, or the
    quaternion has no unit norm.
    """
    numbers = np.array([*position, *(orientation or ())])
    if not (np.abs(numbers) <= REMOTEST).all():
        raise KinfeasError(f"a goal must have finite numbers of at most {REMOTEST:,.0f} in size")
    if orientation is None:
        return GoalTask(numbers, None, motion)
    rotation = numbers[3:]
    if len(rotation) == 3:
        rotation = Rotation.from_euler("xyz", rotation).as_quat()
    elif abs(float(np.linalg.norm(rotation)) - 1.0) > spatial.UNIT:
        raise KinfeasError("the goal's quaternion must be of length 1")
    return GoalTask(numbers[:3], rotation / np.linalg.norm(rotation), motion)


def begin(
    task: Task,
    solver: IkSolver,
    rng: np.random.Generator,
    measured: RobotState | None,
    solids: Solids | None = None,
) -> Start:
    """Return the start of a run, as a batch of one, at the measured state of a real robot if any.

    `solids`, one row, are by default those of the task; around a real robot, its furniture.
    """
    start = sample_start(task, solver, rng)
    if measured is not None:
        base, joints = measured.base_pose[0], measured.joint_positions[0]
        around = None
        if isinstance(task, ChainTask) and task.scene is not None:
            # Of what the task draws at random, nothing is around the robot.
            around = task.furniture(start.target_poses)
        start = replace(start, base_pose=base, joint_positions=joints, solids=around)
        if isinstance(task, GoalTask):
            start = task.aimed(solver, start)
    return stacked([start if solids is None else replace(start, solids=solids)])
