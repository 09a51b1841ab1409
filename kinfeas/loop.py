"""The loop: motion generator, policy, inverse kinematics and backend, n robots at a time."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinfeas import spatial
from kinfeas.backend import Backend, Gripping, Resumable, RobotState, Stochastic
from kinfeas.course import Course, Rows
from kinfeas.drive import base_twist
from kinfeas.errors import KinfeasError
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolver
from kinfeas.legs import GOAL_METRES, GOAL_RADIANS, SETTLED_METRES, LegMotion, Pace
from kinfeas.observation import HORIZON, observe
from kinfeas.policy import Situation
from kinfeas.spatial import Array
from kinfeas.start import Start

__all__ = ["Loop", "Rows", "Step"]


@dataclass(frozen=True)
class Step:
    """What one step of the loop came to, each of leading shape (n,).

    Attributes:
        feasible: Whether IK found the desired pose.
        position_error: Metres that the IK solution, or its closest attempt, leaves.
        rotation_error: The same in radians.
        deviation: Distance of the achieved EE from the desired position, metres.
        leg: Number of the leg that the step was a part of.
        goal_distance: Distance of the achieved EE from the end of that leg, metres.
        goal_angle: The same in radians.
        finished: Whether the end of the last leg was reached, on this feasible step.
        jumped: Whether an arm joint was asked to move faster than its limit.
    """

    feasible: NDArray[np.bool_]
    position_error: Array
    rotation_error: Array
    deviation: Array
    leg: NDArray[np.intp]
    goal_distance: Array
    goal_angle: Array
    finished: NDArray[np.bool_]
    jumped: NDArray[np.bool_]


class Loop:
    """n robots, each carrying its own EE motion."""

    def __init__(
        self,
        solver: IkSolver,
        legs: Sequence[LegMotion],
        backend: Backend,
        dt: float = HORIZON,
        pace: Pace | None = None,
    ) -> None:
        """Connect the parts; `start` must follow before anything else.

        Args:
            solver: Places the arm; it also says which robot this is.
            legs: Motions that every EE makes one after the other, at least one.
            backend: Moves the robots.
            dt: Control period in seconds.
            pace: How the motions are carried out; as they are planned by default.
        """
        pace = pace or Pace()
        self.solver, self.backend, self.dt = solver, backend, dt
        self.robot = solver.robot
        self.course = Course(legs, self.robot, dt, pace)
        self._motion_time = dt / pace.slow_down
        self._sent: Array = np.empty((0, len(self.robot.arm)))
        self._velocity = np.array([joint.velocity for joint in self.robot.arm])
        self._continuous = np.array([joint.continuous for joint in self.robot.arm])

    def start(
        self, start: Start, rngs: Sequence[np.random.Generator], rows: Rows | None = None
    ) -> None:
        """Begin new episodes.

        Args:
            start: Where the m episodes begin.
            rngs: One source of randomness for each of them.
            rows: Which of the n robots begin anew; all of them by default, which also sets n.
        """
        if isinstance(self.backend, Stochastic):
            seeds = np.array([rng.integers(2**64, dtype=np.uint64) for rng in rngs])
            self.backend.seed(seeds, np.arange(len(rngs)) if rows is None else rows)
        state = self.backend.reset(start.base_pose, start.joint_positions, rows)
        ee = spatial.compose(start.base_pose, forward(self.solver.chain, start.joint_positions))
        self.course.start(ee, start.target_poses, rngs, rows)
        self._measured(state)
        joints = state.joint_positions.copy()
        if rows is not None:
            others = np.setdiff1d(np.arange(len(joints)), rows)
            joints[others] = self._sent[others]
        self._sent = joints
        self._look_ahead()

    def step(self, action: Array) -> Step:
        """Advance all robots by one control period.

        A leg ends on a feasible step that brings the EE to its end; after its wait the next leg
        begins at the desired pose.

        Args:
            action: Base commands in [-1, 1], shape (n, 3) or (n, 2).
        """
        # What was looked ahead for is not computed again.
        course = self.course
        time = self._motion_time
        course.move(self._ahead if time == HORIZON else course.ahead(time))
        command = base_twist(self.robot.base, self.state.base_pose, action, self.dt)
        commanded = spatial.integrate(self.state.base_pose, command, self.dt)
        before = self._sent
        target = spatial.relative(course.desired, commanded)
        arm = self.solver.solve(target, before, self._velocity * self.dt)
        self._sent = arm.joint_positions
        self._measured(self.backend.step(command, self._sent, self.dt))
        goal_distance, goal_angle = spatial.distance(self.ee_pose, course.goal)
        arrived = arm.feasible & (goal_distance <= GOAL_METRES) & (goal_angle <= GOAL_RADIANS)
        step = Step(
            feasible=arm.feasible,
            position_error=arm.position_error,
            rotation_error=arm.rotation_error,
            deviation=np.linalg.norm(self.ee_pose[:, :3] - course.desired[:, :3], axis=1),
            leg=course.leg,
            goal_distance=goal_distance,
            goal_angle=goal_angle,
            finished=arrived & course.last,
            jumped=self._jumped(before, arm.joint_positions),
        )
        stops = course.advance(arrived, arrived & (goal_distance <= SETTLED_METRES))
        self._grip(step.leg, stops | step.finished)
        self._look_ahead()
        return step

    def snapshot(self) -> dict[str, NDArray[Any]]:
        """Return everything that the loop goes on from, by name.

        Raises:
            KinfeasError: If the backend cannot be put into arrays.
        """
        if not isinstance(self.backend, Resumable):
            raise KinfeasError(
                f"{type(self.backend).__name__} cannot be saved in the midst of a run"
            )
        return {**self.backend.snapshot(), **self.course.snapshot()}

    def restore(self, snapshot: Mapping[str, NDArray[Any]]) -> None:
        """Go on from what `snapshot` returned."""
        if not isinstance(self.backend, Resumable):
            raise KinfeasError(f"{type(self.backend).__name__} cannot go on from a saved run")
        self.course.restore(snapshot)
        self._measured(self.backend.restore(snapshot))
        self._sent = self.state.joint_positions
        self._look_ahead()

    @property
    def desired(self) -> Array:
        """Desired world pose of the EE now, shape (n, 7)."""
        return self.course.desired

    @property
    def situation(self) -> Situation:
        """What a policy may look at now."""
        return Situation(
            observation=self.observation,
            base_pose=self.state.base_pose,
            ee_pose=self.ee_pose,
            desired=self.desired,
            planned=self.planned,
            demonstrated_base=self.course.demonstrated_base,
        )

    def _measured(self, state: RobotState) -> None:
        """Take in what the backend measured."""
        self.state = state
        self._ee_in_base = forward(self.solver.chain, state.joint_positions)
        self.ee_pose = spatial.compose(state.base_pose, self._ee_in_base)

    def _grip(self, leg: NDArray[np.intp], stops: NDArray[np.bool_]) -> None:
        """Let the grippers do what the legs say that have just come to their end."""
        if not (isinstance(self.backend, Gripping) and stops.any()):
            return
        for number, one in enumerate(self.course.legs):
            rows = np.flatnonzero(stops & (leg == number))
            if one.grip is not None and rows.size:
                self.backend.grip(one.grip, rows)

    def _look_ahead(self) -> None:
        """Find where the motions lead from here, and what a policy sees of that."""
        self.goal = self.course.goal
        self._ahead = self.course.ahead(HORIZON)
        self.planned = self._ahead[0]
        base, joints = self.state.base_pose, self.state.joint_positions
        self.observation = observe(base, self._ee_in_base, self.planned, self.goal, joints)

    def _jumped(self, before: Array, after: Array) -> NDArray[np.bool_]:
        move = np.where(self._continuous, spatial.wrap(after - before), after - before)
        # Rounding must not turn a motion at the very limit into a jump.
        jumped: NDArray[np.bool_] = np.any(np.abs(move) > self._velocity * self.dt * 1.001, axis=1)
        return jumped
