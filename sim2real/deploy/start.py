"""The start of a run: the task of a single goal, checks of reach, and compiled kernels."""

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from kinfeas.config import PluginSpec, registry
from kinfeas.control.assemble import assemble, build_backend
from kinfeas.control.loop import Loop
from kinfeas.control.period import CommandFilter
from kinfeas.control.subgoal_motions import subgoal_ends
from kinfeas.core import spatial
from kinfeas.core.backend import RobotState
from kinfeas.core.errors import KinfeasError
from kinfeas.core.metrics import GOAL_METRES, GOAL_RADIANS
from kinfeas.core.policy import Policy
from kinfeas.core.quantities import REMOTEST
from kinfeas.core.solids import Solids
from kinfeas.core.spatial import Array
from kinfeas.core.start import Start, stacked
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolver
from kinfeas.planning.reach import BasePlacer
from kinfeas.sim2real.deploy.config import Guards
from kinfeas.sim2real.deploy.guards import Guarded
from kinfeas.tasks.chain import ChainTask
from kinfeas.tasks.task import MotionSpec, Subgoal, Task, build_subgoals, sample_start

_WARM_UP_STEPS = 5
_WARM_UP_MOTION = np.array([0.5, 0.2, 0.0, 0.0, 0.0, 0.0, 0.0])  # m, from the EE to its targets
_WARM_UP_SOLIDS = Solids.from_table(np.array([[0.0, 3.0, 0, 0.2, 0.2, 0, 1, 0, 0, 0, 0]]))  # a box


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

    `solids`, one row, replace those of the task, of which only furniture is around a real robot.
    """
    start = sample_start(task, solver, rng)
    if measured is not None:
        base, joints = measured.base_pose[0], measured.joint_positions[0]
        around = None
        if isinstance(task, ChainTask) and task.scene is not None:
            # Objects that the task draws at random are not around the robot.
            around = task.furniture(start.target_poses)
        start = replace(start, base_pose=base, joint_positions=joints, solids=around)
        if isinstance(task, GoalTask):
            start = task.aimed(solver, start)
    return stacked([start if solids is None else replace(start, solids=solids)])


def preflight(loop: Loop, start: Start, rng: np.random.Generator, guards: Guards) -> str:
    """Return a warning if the EE may outrun the base, or an empty string.

    `start` is a batch of one; `rng` is not advanced. Raises KinfeasError if no base pose is found
    from which the arm reaches the end of a sub-goal.
    """
    if guards.reach:
        goals = subgoal_ends(loop.solver, loop.sequence.subgoals, start, [deepcopy(rng)])
        _check_reach(loop.solver, goals[0])
    fastest = loop.robot.base.max_velocity
    scale = (guards.max_linear_velocity or fastest) / fastest
    if scale >= loop.execution.time_scale:
        return ""
    return (
        f"guards.max_linear_velocity limits the base to {scale:.0%} of its velocity, but the EE "
        f"moves at {loop.execution.time_scale:.0%}: the setting time_scale={scale:.2g} slows it"
    )


def warm_up(
    solver: IkSolver,
    policy: Policy,
    task: Task,
    dt: float,
    adapters: Sequence[PluginSpec] = (),
    filters: Sequence[PluginSpec | CommandFilter] = (),
) -> None:
    """Compile the kernels of a run by a few steps in the analytic world.

    Adapters that need an ability of their backend are left out.
    """
    robot, rng = solver.robot, np.random.default_rng(0)
    joints = robot.home["home"][np.newaxis]
    target = forward(solver.chain, joints) + _WARM_UP_MOTION
    targets = np.stack([target] * len(task.subgoals), axis=1)
    analytic = build_backend("analytic", {}, robot=robot)
    kinds = [(spec, registry.load("kinfeas.adapters", spec.name)) for spec in adapters]
    general = [spec for spec, kind in kinds if not getattr(kind, "needs", "")]
    backend = Guarded(analytic, robot, Guards().timeless(), adapters=general)
    subgoals = build_subgoals(task.subgoals)
    loop = assemble(solver, subgoals, backend, dt=dt, filters=filters, policy=policy)
    loop.start(Start(spatial.IDENTITY[np.newaxis], joints, targets, _WARM_UP_SOLIDS), [rng])
    for _ in range(_WARM_UP_STEPS):
        loop.step()


def _check_reach(solver: IkSolver, goals: Array) -> None:
    options = solver.options
    options = replace(
        options, pose_tolerance=False,
        position_tolerance=max(options.position_tolerance, GOAL_METRES),
        rotation_tolerance=max(options.rotation_tolerance, GOAL_RADIANS),
    )  # fmt: skip
    placer = BasePlacer(solver.robot, options)
    reasons = [placer.place(goal, count=1).reason for goal in goals]
    if not any(reasons):
        return
    first = next(number for number, reason in enumerate(reasons) if reason)
    goal = "the goal" if len(goals) == 1 else f"the end of sub-goal {first + 1} of {len(goals)}"
    numbers = np.round([*goals[first, :3], *spatial.rpy(goals[first])], 3)
    x, y, z, roll, pitch, yaw = (f"{value + 0.0:g}" for value in numbers)
    raise KinfeasError(
        f"no base pose was found from which the arm reaches {goal}, x {x}, y {y}, z {z} m, roll "
        f"{roll}, pitch {pitch}, yaw {yaw} rad ({reasons[first]}); the setting "
        "guards.reach=false skips this check"
    )
