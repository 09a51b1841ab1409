"""The loop: motion generator, policy, inverse kinematics and backend, n robots at a time."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinfeas import spatial
from kinfeas.backend import Backend, Gripping, Resumable, RobotState, Stochastic
from kinfeas.clearance import Clearance
from kinfeas.conformance.adapter import unchecked
from kinfeas.course import Course
from kinfeas.drive import action_size
from kinfeas.errors import KinfeasError
from kinfeas.following import Following
from kinfeas.joints import joint_way, jumps
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolver
from kinfeas.legs import (
    GOAL_METRES,
    GOAL_RADIANS,
    SETTLED_METRES,
    SWING_SECONDS,
    LegMotion,
    Pace,
)
from kinfeas.observation import HORIZON, observe
from kinfeas.policy import Situation
from kinfeas.rows import Rows
from kinfeas.spatial import Array
from kinfeas.start import Start
from kinfeas.yielding import Yielding

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
    """n robots, each carrying its own EE motion.

    Attributes:
        sent: Arm joints that were last commanded, shape (n, j).
        periods: Control periods since each row was started, shape (n,).
    """

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

        Raises:
            KinfeasError: If the bases are to keep clear of what the backend does not know.
        """
        self.pace = pace = pace or Pace()
        self.solver, self.backend, self.dt = solver, backend, dt
        self.robot = solver.robot
        self.course = Course(legs, self.robot, dt, pace)
        self._motion_time = dt / pace.slow_down
        self._patience = round(pace.patience / dt)
        self._following = Following(solver, dt)
        self._yielding = Yielding(self._following) if pace.yields else None
        self._clearance = (
            Clearance(self.robot.base, backend, pace.clearance, dt) if pace.clearance else None
        )
        self._stood: NDArray[np.intp] = np.empty(0, dtype=np.intp)
        self.periods: NDArray[np.intp] = np.empty(0, dtype=np.intp)
        self.sent: Array = np.empty((0, len(self.robot.arm)))

    def start(
        self, start: Start, rngs: Sequence[np.random.Generator], rows: Rows | None = None
    ) -> None:
        """Begin new episodes.

        Args:
            start: Where the m episodes begin.
            rngs: One source of randomness for each of them.
            rows: Which of the n robots begin anew; all of them by default, which also sets n.
        """
        # Drawn whether or not anybody takes them: adapters do not change what the course draws.
        seeds = np.array([rng.integers(2**64, dtype=np.uint64) for rng in rngs])
        if isinstance(self.backend, Stochastic):
            self.backend.seed(seeds, np.arange(len(rngs)) if rows is None else rows)
        state = self.backend.reset(start.base_pose, start.joint_positions, rows)
        ee = spatial.compose(start.base_pose, forward(self.solver.chain, start.joint_positions))
        self.course.start(ee, start.target_poses, rngs, rows)
        self._measured(state)
        joints = state.joint_positions.copy()
        if rows is not None:
            others = np.setdiff1d(np.arange(len(joints)), rows)
            joints[others] = self.sent[others]
        self.sent = joints
        if rows is None:
            self.periods, self._stood = np.zeros((2, len(joints)), dtype=np.intp)
        else:
            self.periods[rows] = self._stood[rows] = 0
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
        held = self._hold() if self._patience else None
        course.move(self._ahead if time == HORIZON else course.ahead(time), held)
        if held is not None:
            action = np.where(held[:, np.newaxis], 0.0, action)
        before, base_pose = self.sent, self.state.base_pose
        limits = None
        if self._clearance is not None:
            limits = self._clearance.limits(len(action))
            action = limits.hold(action[:, np.newaxis])[:, 0]
        wanted = (action, base_pose, course.desired, before)
        if self._yielding is None:
            command, arm = self._following(*wanted)
        else:
            command, arm = self._yielding(*wanted, held, limits)
        self.sent = arm.joint_positions
        self._measured(self.backend.step(command, self.sent, self.dt))
        goal_distance, goal_angle = spatial.distance(self.ee_pose, course.goal)
        arrived = arm.feasible & (goal_distance <= GOAL_METRES) & (goal_angle <= GOAL_RADIANS)
        step = Step(
            feasible=arm.feasible,
            position_error=arm.position_error,
            rotation_error=arm.rotation_error,
            deviation=np.linalg.norm(self.truth[1][:, :3] - course.desired[:, :3], axis=1),
            leg=course.leg,
            goal_distance=goal_distance,
            goal_angle=goal_angle,
            finished=arrived & course.last,
            jumped=jumps(self.robot, before, arm.joint_positions, self.dt),
        )
        stops = course.advance(arrived, arrived & (goal_distance <= SETTLED_METRES))
        self._grip(step.leg, stops | step.finished)
        self.periods += 1
        self._look_ahead()
        return step

    def snapshot(self) -> dict[str, NDArray[Any]]:
        """Return everything that the loop goes on from, by name.

        Raises:
            KinfeasError: If the backend cannot be put into arrays.
        """
        if not isinstance(self.backend, Resumable):
            name = type(unchecked(self.backend)).__name__
            raise KinfeasError(f"{name} cannot be saved in the midst of a run")
        return {**self.imagined(), **self.backend.snapshot()}

    def imagined(self) -> dict[str, NDArray[Any]]:
        """Return what a loop in the analytic world would go on from, if it were here now."""
        return {
            "base_pose": self.state.base_pose,
            "joint_positions": self.state.joint_positions,
            "sent": self.sent,
            "periods": self.periods.copy(),
            "stood": self._stood.copy(),
            **self.course.snapshot(),
        }

    def restore(self, snapshot: Mapping[str, NDArray[Any]]) -> None:
        """Go on from what `snapshot` returned."""
        if not isinstance(self.backend, Resumable):
            name = type(unchecked(self.backend)).__name__
            raise KinfeasError(f"{name} cannot go on from a saved run")
        self.course.restore(snapshot)
        self._measured(self.backend.restore(snapshot))
        self.sent, self.periods = snapshot["sent"].copy(), snapshot["periods"].copy()
        self._stood = snapshot["stood"].copy()
        self._look_ahead()

    @property
    def action_size(self) -> int:
        """How many numbers command the base."""
        return action_size(self.robot.base)

    @property
    def desired(self) -> Array:
        """Desired world pose of the EE now, shape (n, 7)."""
        return self.course.desired

    @property
    def truth(self) -> tuple[Array, Array]:
        """Where base and EE really are, as far as the backend knows, shape (n, 7) each."""
        truth = self.state.truth
        if truth is None:
            return self.state.base_pose, self.ee_pose
        return truth.base_pose, spatial.compose(truth.base_pose, self._ee_of(truth))

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
        self._ee_in_base = self._ee_of(state)
        self.ee_pose = spatial.compose(state.base_pose, self._ee_in_base)

    def _ee_of(self, state: RobotState) -> Array:
        if state.ee_in_base is not None:
            return state.ee_in_base
        return forward(self.solver.chain, state.joint_positions)

    def _grip(self, leg: NDArray[np.intp], stops: NDArray[np.bool_]) -> None:
        """Let the grippers do what the legs say that have just come to their end."""
        if not (stops.any() and isinstance(self.backend, Gripping)):
            return
        for number, one in enumerate(self.course.legs):
            rows = np.flatnonzero(stops & (leg == number))
            if one.grip is not None and rows.size:
                self.backend.grip(one.grip, rows)

    def _look_ahead(self) -> None:
        """Find where the motions lead from here, and what a policy sees of that."""
        self.goal = self.course.goal
        self._ahead = self.course.ahead(HORIZON)
        planned, slow_down = self._ahead[0], self.pace.slow_down
        base, joints = self.state.base_pose, self.state.joint_positions
        self.observation = observe(base, self._ee_in_base, planned, self.goal, joints)
        if slow_down != 1.0:
            twist = spatial.twist_between(self.desired, planned, HORIZON)
            planned = spatial.integrate(self.desired, twist, HORIZON / slow_down)
        self.planned = planned

    def _hold(self) -> NDArray[np.bool_]:
        """Return which rows stand still in this period, shape (n,): their arms swing.

        Policies know arms that are where they were sent. Until an arm is there, they would see the
        EE far from where it should be, and let the base run after it.
        """
        way = np.abs(joint_way(self.robot, self.state.joint_positions, self.sent))
        swings = np.any(way > self.robot.max_joint_velocity * SWING_SECONDS, axis=1)
        self._stood = np.where(swings, self._stood + 1, 0)
        held: NDArray[np.bool_] = swings & (self._stood <= self._patience)
        return held
