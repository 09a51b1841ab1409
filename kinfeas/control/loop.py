"""The loop: motion generator, policy, inverse kinematics and backend, n robots at a time."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinfeas.control.drive import action_size
from kinfeas.control.filters.feasibility import FeasibilityFilter
from kinfeas.control.filters.obstacles import ObstacleFilter
from kinfeas.control.kinematic_step import KinematicStep
from kinfeas.control.motion_sequence import MotionSequence
from kinfeas.control.observation import HORIZON, observe
from kinfeas.control.subgoals import (
    GRASP_METRES,
    RECONFIGURATION_SECONDS,
    ExecutionConfig,
    SubgoalMotion,
)
from kinfeas.core import spatial
from kinfeas.core.backend import Backend, Resumable, RobotState, Stochastic, SupportsGripper
from kinfeas.core.checks.adapter import unchecked
from kinfeas.core.errors import KinfeasError
from kinfeas.core.metrics import GOAL_METRES, GOAL_RADIANS
from kinfeas.core.policy import PolicyInput
from kinfeas.core.rows import Rows
from kinfeas.core.spatial import Array
from kinfeas.core.start import Start
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolver
from kinfeas.robots.robot import joint_displacement, joint_jumps

__all__ = ["Loop", "Rows", "Step"]


@dataclass(frozen=True)
class Step:
    """What one step of the loop came to, each of leading shape (n,).

    Attributes:
        feasible: Whether IK found the desired pose.
        position_error: Metres that the IK solution, or its closest attempt, leaves.
        rotation_error: The same in radians.
        deviation: Distance of the achieved EE from the desired position, metres; the true one
            where the backend knows it.
        sub-goal: Number of the sub-goal that the step was a part of.
        goal_distance: Distance of the achieved EE from the end of that sub-goal, metres.
        goal_angle: The same in radians.
        finished: Whether the end of the last sub-goal was reached, on this feasible step.
        joint_jump: Whether an arm joint was asked to move faster than its limit.
    """

    feasible: NDArray[np.bool_]
    position_error: Array
    rotation_error: Array
    deviation: Array
    subgoal: NDArray[np.intp]
    goal_distance: Array
    goal_angle: Array
    finished: NDArray[np.bool_]
    joint_jump: NDArray[np.bool_]


class Loop:
    """n robots, each carrying its own EE motion.

    Attributes:
        joint_command: Arm joints that were last commanded, shape (n, j).
        periods: Control periods since each row was started, shape (n,).
    """

    def __init__(
        self,
        solver: IkSolver,
        subgoals: Sequence[SubgoalMotion],
        backend: Backend,
        dt: float = HORIZON,
        execution: ExecutionConfig | None = None,
    ) -> None:
        """Connect the parts; `start` must follow before anything else.

        Args:
            solver: Places the arm; it also says which robot this is.
            subgoals: Motions that every EE makes one after the other, at least one.
            backend: Moves the robots.
            dt: Control period in seconds.
            execution: How the motions are carried out; as they are planned by default.

        Raises:
            KinfeasError: If the bases are to keep clear of what the backend does not know.
        """
        self.execution = execution = execution or ExecutionConfig()
        self.solver, self.backend, self.dt = solver, backend, dt
        self.robot = solver.robot
        self.sequence = MotionSequence(subgoals, self.robot, dt, execution)
        self._motion_time = dt / execution.slow_down
        self._arm_settle_timeout = round(execution.arm_settle_timeout / dt)
        self._kinematic_step = KinematicStep(solver, dt)
        self._feasibility_filter = (
            FeasibilityFilter(self._kinematic_step) if execution.feasibility_filter else None
        )
        self._obstacle_filter = (
            ObstacleFilter(self.robot.base, backend, execution.min_obstacle_distance, dt)
            if execution.min_obstacle_distance
            else None
        )
        self._stood: NDArray[np.intp] = np.empty(0, dtype=np.intp)
        self.periods: NDArray[np.intp] = np.empty(0, dtype=np.intp)
        self.joint_command: Array = np.empty((0, len(self.robot.arm)))

    def start(
        self, start: Start, rngs: Sequence[np.random.Generator], rows: Rows | None = None
    ) -> None:
        """Begin new episodes.

        Args:
            start: Where the m episodes begin.
            rngs: One source of randomness for each of them.
            rows: Which of the n robots begin anew; all of them by default, which also sets n.
        """
        # Drawn whether or not anybody takes them: adapters do not change what the motion sequence
        # draws.
        seeds = np.array([rng.integers(2**64, dtype=np.uint64) for rng in rngs])
        if isinstance(self.backend, Stochastic):
            self.backend.seed(seeds, np.arange(len(rngs)) if rows is None else rows)
        state = self.backend.reset(start.base_pose, start.joint_positions, rows)
        ee = spatial.compose(start.base_pose, forward(self.solver.chain, start.joint_positions))
        self.sequence.start(ee, start.target_poses, rngs, rows)
        self._measured(state)
        joints = state.joint_positions.copy()
        if rows is not None:
            others = np.setdiff1d(np.arange(len(joints)), rows)
            joints[others] = self.joint_command[others]
        self.joint_command = joints
        if rows is None:
            self.periods, self._stood = np.zeros((2, len(joints)), dtype=np.intp)
        else:
            self.periods[rows] = self._stood[rows] = 0
        self._plan()

    def step(self, action: Array) -> Step:
        """Advance all robots by one control period.

        A sub-goal ends on a feasible step that brings the EE to its end; after its wait the next
        sub-goal begins at the desired pose.

        Args:
            action: Base commands in [-1, 1], shape (n, 3) or (n, 2).
        """
        # What was looked ahead for is not computed again.
        sequence = self.sequence
        time = self._motion_time
        paused = self._paused() if self._arm_settle_timeout else None
        sequence.move(self._ahead if time == HORIZON else sequence.ahead(time), paused)
        if paused is not None:
            action = np.where(paused[:, np.newaxis], 0.0, action)
        before, base_pose = self.joint_command, self.state.base_pose
        limits = None
        if self._obstacle_filter is not None:
            limits = self._obstacle_filter.limits(len(action))
            action = limits.hold(action[:, np.newaxis])[:, 0]
        wanted = (action, base_pose, sequence.desired, before)
        if self._feasibility_filter is None:
            command, arm = self._kinematic_step(*wanted)
        else:
            command, arm = self._feasibility_filter(*wanted, paused, limits)
        self.joint_command = arm.joint_positions
        self._measured(self.backend.step(command, self.joint_command, self.dt))
        goal_distance, goal_angle = spatial.distance(self.ee_pose, sequence.goal)
        arrived = arm.feasible & (goal_distance <= GOAL_METRES) & (goal_angle <= GOAL_RADIANS)
        step = Step(
            feasible=arm.feasible,
            position_error=arm.position_error,
            rotation_error=arm.rotation_error,
            deviation=np.linalg.norm(self.true_state[1][:, :3] - sequence.desired[:, :3], axis=1),
            subgoal=sequence.subgoal,
            goal_distance=goal_distance,
            goal_angle=goal_angle,
            finished=arrived & sequence.last,
            joint_jump=joint_jumps(self.robot, before, arm.joint_positions, self.dt),
        )
        stops = sequence.advance(arrived, arrived & (goal_distance <= GRASP_METRES))
        self._grip(step.subgoal, stops | step.finished)
        self.periods += 1
        self._plan()
        return step

    def snapshot(self) -> dict[str, NDArray[Any]]:
        """Return everything that the loop goes on from, by name.

        Raises:
            KinfeasError: If the backend cannot be put into arrays.
        """
        if not isinstance(self.backend, Resumable):
            name = type(unchecked(self.backend)).__name__
            raise KinfeasError(f"{name} cannot be saved in the midst of a run")
        return {**self.kinematic_state(), **self.backend.snapshot()}

    def kinematic_state(self) -> dict[str, NDArray[Any]]:
        """Return what a loop in the analytic world would go on from, if it were here now."""
        return {
            "base_pose": self.state.base_pose,
            "joint_positions": self.state.joint_positions,
            "sent": self.joint_command,
            "periods": self.periods.copy(),
            "stood": self._stood.copy(),
            **self.sequence.snapshot(),
        }

    def restore(self, snapshot: Mapping[str, NDArray[Any]]) -> None:
        """Go on from what `snapshot` returned."""
        if not isinstance(self.backend, Resumable):
            name = type(unchecked(self.backend)).__name__
            raise KinfeasError(f"{name} cannot go on from a saved run")
        self.sequence.restore(snapshot)
        self._measured(self.backend.restore(snapshot))
        self.joint_command, self.periods = snapshot["sent"].copy(), snapshot["periods"].copy()
        self._stood = snapshot["stood"].copy()
        self._plan()

    @property
    def action_size(self) -> int:
        """How many numbers command the base."""
        return action_size(self.robot.base)

    @property
    def desired(self) -> Array:
        """Desired world pose of the EE now, shape (n, 7)."""
        return self.sequence.desired

    @property
    def true_state(self) -> tuple[Array, Array]:
        """Where base and EE really are, as far as the backend knows, shape (n, 7) each."""
        true_state = self.state.true_state
        if true_state is None:
            return self.state.base_pose, self.ee_pose
        return true_state.base_pose, spatial.compose(true_state.base_pose, self._ee_of(true_state))

    @property
    def policy_input(self) -> PolicyInput:
        """What a policy may look at now."""
        return PolicyInput(
            observation=self.observation,
            base_pose=self.state.base_pose,
            ee_pose=self.ee_pose,
            desired=self.desired,
            planned=self.planned,
            demonstrated_base=self.sequence.demonstrated_base,
        )

    def _measured(self, state: RobotState) -> None:
        """Take in what the backend measured."""
        self.state = state
        self._ee_in_base = self._ee_of(state)
        self.ee_pose = spatial.compose(state.base_pose, self._ee_in_base)

    def _ee_of(self, state: RobotState) -> Array:
        if state.ee_in_base is not None:
            return state.ee_in_base
        return forward(self.solver.chain, state.joint_positions)

    def _grip(self, subgoal: NDArray[np.intp], stops: NDArray[np.bool_]) -> None:
        """Let the grippers do what the sub-goals say that have just come to their end."""
        if not (stops.any() and isinstance(self.backend, SupportsGripper)):
            return
        for number, one in enumerate(self.sequence.subgoals):
            rows = np.flatnonzero(stops & (subgoal == number))
            if one.grip is not None and rows.size:
                self.backend.grip(one.grip, rows)

    def _plan(self) -> None:
        """Find where the motions lead from here, and what a policy sees of that."""
        self.goal = self.sequence.goal
        self._ahead = self.sequence.ahead(HORIZON)
        planned, slow_down = self._ahead[0], self.execution.slow_down
        base, joints = self.state.base_pose, self.state.joint_positions
        self.observation = observe(base, self._ee_in_base, planned, self.goal, joints)
        if slow_down != 1.0:
            twist = spatial.twist_between(self.desired, planned, HORIZON)
            planned = spatial.integrate(self.desired, twist, HORIZON / slow_down)
        self.planned = planned

    def _paused(self) -> NDArray[np.bool_]:
        """Return which rows stand still in this period, shape (n,): their arms swing.

        Policies know arms that are where they were sent. Until an arm is there, they would see the
        EE far from where it should be, and let the base run after it.
        """
        way = np.abs(joint_displacement(self.robot, self.state.joint_positions, self.joint_command))
        allow_reconfiguration = np.any(
            way > self.robot.max_joint_velocity * RECONFIGURATION_SECONDS, axis=1
        )
        self._stood = np.where(allow_reconfiguration, self._stood + 1, 0)
        paused: NDArray[np.bool_] = allow_reconfiguration & (
            self._stood <= self._arm_settle_timeout
        )
        return paused
