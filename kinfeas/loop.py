"""The loop: motion generator, policy, inverse kinematics and backend, n robots at a time."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinfeas import spatial
from kinfeas.backend import Backend, Resumable, RobotState, Stochastic
from kinfeas.drive import base_twist
from kinfeas.errors import KinfeasError
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolver
from kinfeas.motion import MotionGenerator, State
from kinfeas.observation import HORIZON, observe
from kinfeas.policy import Situation
from kinfeas.spatial import Array
from kinfeas.start import Start

Rows = NDArray[np.intp]

_MOTION = "motion."


@dataclass(frozen=True)
class Step:
    """What one step of the loop came to, each of leading shape (n,).

    Attributes:
        feasible: Whether IK found the desired pose.
        position_error: Metres that the IK solution, or its closest attempt, leaves.
        rotation_error: The same in radians.
        deviation: Distance of the achieved EE from the desired position, metres.
        goal_distance: Distance of the achieved EE from the motion's end, metres.
        goal_angle: The same in radians.
        jumped: Whether an arm joint was asked to move faster than its limit.
    """

    feasible: NDArray[np.bool_]
    position_error: Array
    rotation_error: Array
    deviation: Array
    goal_distance: Array
    goal_angle: Array
    jumped: NDArray[np.bool_]


class Loop:
    """n robots, each carrying its own EE motion."""

    def __init__(
        self, solver: IkSolver, generator: MotionGenerator, backend: Backend, dt: float = HORIZON
    ) -> None:
        """Connect the parts; `start` must follow before anything else.

        Args:
            solver: Places the arm; it also says which robot this is.
            generator: Moves the EE.
            backend: Moves the robots.
            dt: Control period in seconds.
        """
        self.solver, self.generator, self.backend, self.dt = solver, generator, backend, dt
        self.robot = solver.robot
        self._velocity = np.array([joint.velocity for joint in self.robot.arm])
        self._continuous = np.array([joint.continuous for joint in self.robot.arm])
        self.desired: Array = np.empty((0, 7))
        self.motion: State = {}

    def start(
        self, start: Start, rngs: Sequence[np.random.Generator], rows: Rows | None = None
    ) -> None:
        """Begin new episodes.

        Args:
            start: Where the m episodes begin.
            rngs: One source of randomness for each of them.
            rows: Which of the n robots begin anew; all of them by default, which also sets n.
        """
        every = rows is None
        rows = np.arange(len(rngs)) if rows is None else rows
        if isinstance(self.backend, Stochastic):
            seeds = np.array([rng.integers(2**64, dtype=np.uint64) for rng in rngs])
            self.backend.seed(seeds, rows)
        state = self.backend.reset(start.base_pose, start.joint_positions, None if every else rows)
        ee = spatial.compose(start.base_pose, forward(self.solver.chain, start.joint_positions))
        motion = self.generator.start(ee, start.target_pose, rngs)
        if every:
            self.desired, self.motion = ee, motion
        else:
            # Into copies: others may hold what was there before.
            self.desired = _with_rows(self.desired, rows, ee)
            self.motion = {
                key: _with_rows(self.motion[key], rows, values) for key, values in motion.items()
            }
        self._measured(state)

    def step(self, action: Array) -> Step:
        """Advance all robots by one control period.

        Args:
            action: Base commands in [-1, 1], shape (n, 3) or (n, 2).
        """
        twist, self.motion = self._next_motion()
        self.desired = spatial.integrate(self.desired, twist, self.dt)
        command = base_twist(self.robot.base, self.state.base_pose, action, self.dt)
        commanded = spatial.integrate(self.state.base_pose, command, self.dt)
        before = self.state.joint_positions
        target = spatial.relative(self.desired, commanded)
        arm = self.solver.solve(target, before, self._velocity * self.dt)
        self._measured(self.backend.step(command, arm.joint_positions, self.dt))
        goal_distance, goal_angle = spatial.distance(self.ee_pose, self.goal)
        return Step(
            feasible=arm.feasible,
            position_error=arm.position_error,
            rotation_error=arm.rotation_error,
            deviation=np.linalg.norm(self.ee_pose[:, :3] - self.desired[:, :3], axis=1),
            goal_distance=goal_distance,
            goal_angle=goal_angle,
            jumped=self._jumped(before, arm.joint_positions),
        )

    def snapshot(self) -> dict[str, NDArray[Any]]:
        """Return everything that the loop goes on from, by name.

        Raises:
            KinfeasError: If the backend cannot be put into arrays.
        """
        if not isinstance(self.backend, Resumable):
            raise KinfeasError(
                f"{type(self.backend).__name__} cannot be saved in the midst of a run"
            )
        motion = {f"{_MOTION}{key}": values for key, values in self.motion.items()}
        return {**self.backend.snapshot(), **motion, "desired": self.desired}

    def restore(self, snapshot: Mapping[str, NDArray[Any]]) -> None:
        """Go on from what `snapshot` returned."""
        if not isinstance(self.backend, Resumable):
            raise KinfeasError(f"{type(self.backend).__name__} cannot go on from a saved run")
        self.desired = snapshot["desired"].copy()
        self.motion = {
            key.removeprefix(_MOTION): values.copy()
            for key, values in snapshot.items()
            if key.startswith(_MOTION)
        }
        self._measured(self.backend.restore(snapshot))

    @property
    def situation(self) -> Situation:
        """What a policy may look at now."""
        return Situation(
            observation=self.observation,
            base_pose=self.state.base_pose,
            ee_pose=self.ee_pose,
            desired=self.desired,
            planned=self.planned,
        )

    def _measured(self, state: RobotState) -> None:
        """Take in what the backend measured and look ahead from there."""
        self.state = state
        ee_in_base = forward(self.solver.chain, state.joint_positions)
        self.ee_pose = spatial.compose(state.base_pose, ee_in_base)
        self.goal = self.generator.goal_pose(self.motion)
        self._ahead = self.generator.twist(self.motion, self.desired, HORIZON)
        self.planned = spatial.integrate(self.desired, self._ahead[0], HORIZON)
        self.observation = observe(
            state.base_pose, ee_in_base, self.planned, self.goal, state.joint_positions
        )

    def _next_motion(self) -> tuple[Array, State]:
        """Return the generator's next step; what was looked ahead for is not computed again."""
        if self.dt == HORIZON:
            return self._ahead
        return self.generator.twist(self.motion, self.desired, self.dt)

    def _jumped(self, before: Array, after: Array) -> NDArray[np.bool_]:
        move = np.where(self._continuous, spatial.wrap(after - before), after - before)
        # Rounding must not turn a motion at the very limit into a jump.
        jumped: NDArray[np.bool_] = np.any(np.abs(move) > self._velocity * self.dt * 1.001, axis=1)
        return jumped


def _with_rows(array: NDArray[Any], rows: Rows, values: NDArray[Any]) -> NDArray[Any]:
    changed = array.copy()
    changed[rows] = values
    return changed
