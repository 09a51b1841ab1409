"""Where a run begins and where it leads."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from kinfeas.config.quantities import REMOTEST
from kinfeas.core import spatial
from kinfeas.core.backend import RobotState
from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import Array
from kinfeas.core.start import Start
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolver
from kinfeas.tasks.task import MotionSpec, Subgoal, Task, sample_start

_UNIT = 1e-2  # by which the length of a given quaternion may be off


@dataclass(frozen=True, eq=False)
class GoalTask:
    """One motion of the EE to a given pose, from the origin with the arm at home.

    Attributes:
        goal: World position, shape (3,), metres.
        orientation: Unit quaternion xyzw, shape (4,); the one at the start where None.
        motion: What moves the EE.
        name: Task name.
    """

    goal: Array
    orientation: Array | None = None
    motion: MotionSpec = field(default_factory=MotionSpec)
    name: str = "goal"

    @property
    def subgoals(self) -> tuple[Subgoal, ...]:
        """The one motion, of the EE frame."""
        return (Subgoal(self.motion),)

    def sample(self, solver: IkSolver, rng: np.random.Generator) -> Start:
        """Return the one episode that there is, its arrays without a leading axis."""
        start = Start(spatial.IDENTITY, solver.robot.home["home"], np.empty((1, 7)))
        return self.aimed(solver, start)

    def aimed(self, solver: IkSolver, start: Start) -> Start:
        """Return the same start with the goal as its target, without leading axes."""
        orientation = self.orientation
        if orientation is None:
            ee = forward(solver.chain, start.joint_positions[np.newaxis])
            orientation = spatial.compose(start.base_pose[np.newaxis], ee)[0, 3:]
        target = np.concatenate([self.goal, spatial.canonical(orientation)])
        return replace(start, target_poses=target[np.newaxis])


def make_goal_task(
    position: Sequence[float], orientation: Sequence[float] | None, motion: MotionSpec
) -> GoalTask:
    """Return the task of one goal.

    Args:
        position: World position of the EE, metres.
        orientation: Roll, pitch and yaw about the world's axes in radians, or a quaternion xyzw;
            None for the orientation at the start.
        motion: What moves the EE.

    Raises:
        KinfeasError: If a number is not finite or too large, or the quaternion not of unit length.
    """
    numbers = np.array([*position, *(orientation or ())])
    if not (np.abs(numbers) <= REMOTEST).all():
        most = f"at most {REMOTEST:,.0f} in size"
        raise KinfeasError(f"a goal must be made of finite numbers of {most}")
    if orientation is None:
        return GoalTask(numbers, None, motion)
    turn = numbers[3:]
    if len(turn) == 3:
        turn = Rotation.from_euler("xyz", turn).as_quat()
    elif abs(float(np.linalg.norm(turn)) - 1.0) > _UNIT:
        raise KinfeasError(
            f"the goal's quaternion must be of length 1, not {np.linalg.norm(turn):g}"
        )
    return GoalTask(numbers[:3], turn / np.linalg.norm(turn), motion)


def begin(task: Task, solver: IkSolver, rng: np.random.Generator, now: RobotState | None) -> Start:
    """Return where a run begins, with leading axes of one.

    Args:
        task: What is to be done.
        solver: The robot's kinematics.
        rng: Draws what is not given.
        now: Where a robot stands that cannot be put anywhere else; None for any other.
    """
    start = sample_start(task, solver, rng)
    if now is not None:
        start = replace(start, base_pose=now.base_pose[0], joint_positions=now.joint_positions[0])
        if isinstance(task, GoalTask):
            start = task.aimed(solver, start)
    return Start(
        start.base_pose[np.newaxis],
        start.joint_positions[np.newaxis],
        start.target_poses[np.newaxis],
    )
