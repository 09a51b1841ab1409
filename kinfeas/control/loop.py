"""The loop: motion generator, policy, command filters, IK and backend, n robots at a time."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinfeas.control.execution import (
    GRASP_METRES,
    RECONFIGURATION_SECONDS,
    ExecutionConfig,
    SubgoalMotion,
)
from kinfeas.control.motion_sequence import MotionSequence
from kinfeas.control.observation import (
    ACTION,
    HORIZON,
    OBSERVATION,
    action_size,
    check_names,
    split_action,
)
from kinfeas.control.observer import Observer
from kinfeas.control.obstacles import Obstacles
from kinfeas.control.period import KinematicStep, Period
from kinfeas.control.targets import TargetStream
from kinfeas.core import spatial
from kinfeas.core.backend import Backend, Resumable, RobotState, Stochastic, SupportsGripper
from kinfeas.core.checks import check_array, check_state
from kinfeas.core.errors import KinfeasError, plugin_note
from kinfeas.core.metrics import GOAL_METRES, GOAL_RADIANS
from kinfeas.core.motion import Rows, with_rows
from kinfeas.core.policy import CommandFilter, Policy, PolicyInput, RecurrentPolicy
from kinfeas.core.spatial import Array
from kinfeas.core.start import Start
from kinfeas.kinematics.drive import command_size
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolution, IkSolver
from kinfeas.robots.robot import exceeds_joint_velocity

_TARGETS = "target_stream."

_REPLAN_SECONDS = 1.0
"""Control time between plans around moving solids."""

_NO_ROWS: Rows = np.empty(0, dtype=np.intp)


@dataclass(frozen=True)
class Step:
    """Result of one step of the loop; each array has the leading shape (n,).

    Attributes:
        feasible: Whether IK found the desired pose.
        position_error: Distance from the desired pose to the IK solution or its closest attempt,
            metres.
        rotation_error: The same in radians.
        deviation: Distance of the achieved EE from the desired position, metres; the true one if
            the backend measures it.
        subgoal: Number of the sub-goal of this step.
        goal_distance: Distance of the achieved EE from the end of that sub-goal, metres.
        goal_angle: The same in radians.
        finished: Whether the end of the last sub-goal was reached, on this feasible step.
        joint_jump: Whether an arm joint was commanded to move faster than its limit.
        time_scale: Share of the planned motion that was carried out.
        collision: Whether the base, then the arm, touches a solid, shape (n, 2); None without any,
            or if the loop does not find them.
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
    time_scale: Array
    collision: NDArray[np.bool_] | None = None


class Loop:
    """n robots, each following its own EE motion.

    Attributes:
        obstacles: Solids and scans, where the backend has them.
        observer: Observes the robots, with the terms of the policy.
        policy: Policy that commands the bases, or None while it learns. Set it by `set_policy`.
        target_stream: Targets that move; then no sub-goal ends. None for those of the start.
        joint_command: Last commanded arm joints, shape (n, j).
        periods: Control periods since the start of each row, shape (n,).
        time_scale: Share of the planned motion that the last step carried out, shape (n,).
        policy_input: Input of the policy now.
        period: What a step is about to carry out, for the filters.
        finds_collisions: Whether steps say which robots touch solids.
    """

    policy_input: PolicyInput
    period: Period
    finds_collisions: bool = True

    def __init__(
        self,
        solver: IkSolver,
        subgoals: Sequence[SubgoalMotion],
        backend: Backend,
        dt: float = HORIZON,
        execution: ExecutionConfig | None = None,
        filters: Sequence[CommandFilter] = (),
    ) -> None:
        """Connect the parts; call `start` before anything else.

        Args:
            solver: IK of the robot.
            subgoals: Motions that every EE makes in sequence, at least one.
            backend: Moves the robots.
            dt: Control period in seconds.
            execution: As planned by default.
            filters: Change the policy's commands, in this order.
        """
        self.execution = execution = execution or ExecutionConfig()
        self.solver, self.backend, self.dt, self.filters = solver, backend, dt, tuple(filters)
        self._note, self._unchecked = plugin_note(f"backend {type(backend).__name__}"), True
        self.robot = solver.robot
        self.sequence = MotionSequence(subgoals, solver, dt, execution)
        self.kinematic_step = KinematicStep(solver, dt)
        self.policy: Policy | None = None
        self._recurrent: RecurrentPolicy | None = None
        self.target_stream: TargetStream | None = None
        self.time_scale: Array = np.empty(0)
        self.action_terms = ACTION
        self.previous_command: Array = np.empty((0, self.command_size))
        self._motion_time = dt * execution.time_scale
        # Once, since protocols are checked by looking up each of their members.
        self._stochastic = backend if isinstance(backend, Stochastic) else None
        self._gripper = backend if isinstance(backend, SupportsGripper) else None
        self.obstacles = Obstacles(backend, solver.collision)
        self.observer = Observer(self.sequence, self.obstacles, dt, execution.time_scale)
        self._arm_settle_timeout = round(execution.arm_settle_timeout / dt)
        self._waited: NDArray[np.intp] = np.empty(0, dtype=np.intp)
        self.periods: NDArray[np.intp] = np.empty(0, dtype=np.intp)
        self.joint_command: Array = np.empty((0, len(self.robot.arm)))

    def set_policy(self, policy: Policy) -> None:
        """Use a policy: its terms, and its `reset` at each start if it has one.

        Raises:
            KinfeasError: If a term is unknown or there twice, or the base velocity is not first.
        """
        terms = getattr(policy, "observation_terms", OBSERVATION)
        actions = getattr(policy, "action_terms", ACTION)
        check_names(terms, actions, f"policy {type(policy).__name__}: ")
        self.policy, self.observer.terms, self.action_terms = policy, tuple(terms), tuple(actions)
        self._recurrent = policy if isinstance(policy, RecurrentPolicy) else None

    def start(
        self, start: Start, rngs: Sequence[np.random.Generator], rows: Rows | None = None
    ) -> None:
        """Begin new episodes.

        Args:
            start: Starts of the m episodes.
            rngs: One source of randomness for each of them.
            rows: Which of the n robots begin anew; all of them by default, which also sets n.
        """
        # Drawn with and without adapters, so that adapters do not change the motions.
        seeds = np.array([rng.integers(2**64, dtype=np.uint64) for rng in rngs])
        fresh = np.arange(len(rngs)) if rows is None else rows
        if self._stochastic is not None:
            self._stochastic.seed(seeds, fresh)
        with self._note:
            state = self.backend.reset(start.base_pose, start.joint_positions, rows)
            self.obstacles.place(start.solids, fresh)
        self._check("reset", state, len(rngs) if rows is None else len(self.joint_command))
        self._unchecked = True
        ee = spatial.compose(start.base_pose, forward(self.solver.chain, start.joint_positions))
        self.sequence.start(ee, start.target_poses, rngs, rows)
        self._measure(state)
        if (solids := self.obstacles.after(0.0)) is not None:
            self.sequence.avoid(solids, fresh, (state.base_pose, state.joint_positions))
        if rows is None:
            joints = state.joint_positions.copy()
            self.periods, self._waited = np.zeros((2, len(joints)), dtype=np.intp)
            self.previous_command = np.zeros((len(joints), self.command_size))
            self.time_scale = np.ones(len(joints))
        else:
            joints = with_rows(self.joint_command, rows, state.joint_positions[rows])
            self.periods[rows] = self._waited[rows] = 0
            self.previous_command = with_rows(self.previous_command, rows, np.array(0.0))
            self.time_scale = with_rows(self.time_scale, rows, np.array(1.0))
        self.joint_command = joints
        if self.target_stream is not None:
            self.target_stream.start(self, rngs, fresh)
            self.sequence.aim(self.target_stream.targets(self, fresh))
        self._observe()
        if self._recurrent is not None:
            with plugin_note(f"policy {type(self._recurrent).__name__}"):
                self._recurrent.reset(self, fresh)
        for one in self.filters:
            with plugin_note(f"command filter {type(one).__name__}"):
                one.reset(self, fresh)

    def step(self, action: Array) -> Step:
        """Advance all robots by one control period.

        A sub-goal ends on a feasible step that brings the EE to its end, with a path of its own at
        the end of that; the next sub-goal begins at the desired pose, after the dwell time.

        Args:
            action: Action terms, clipped to [-1, 1], shape (n, a).
        """
        sequence, before = self.sequence, self.joint_command
        command, time_scale, torso = split_action(action, self.action_terms)
        self.period = period = self._begin_period(torso)
        if time_scale is not None:
            self.slow_down(time_scale)
        self.previous_command = command = self._filtered(command)
        sequence.move(period.plan, period.paused)
        twist, arm = self._solve(command)
        self.time_scale = np.where(period.motion_seconds > 0.0, period.time_scale, 0.0)
        self.joint_command = arm.joint_positions
        with self._note:
            state = self.backend.step(twist, self.joint_command, self.dt)
        if self._unchecked:
            self._check("step", state, len(twist))
            self._unchecked = False
        self._measure(state)
        collision = self.obstacles.collisions(state) if self.finds_collisions else None
        goal_distance, goal_angle = spatial.distance(self.ee_pose, sequence.goal)
        near = (goal_distance <= GOAL_METRES) & (goal_angle <= GOAL_RADIANS)
        arrived = sequence.ended(arm.feasible & near)
        if self.target_stream is not None:
            arrived = np.zeros_like(arrived)
        step = Step(
            feasible=arm.feasible,
            position_error=arm.position_error,
            rotation_error=arm.rotation_error,
            deviation=spatial.distance(self.true_state[1], sequence.desired)[0],
            subgoal=sequence.subgoal,
            goal_distance=goal_distance,
            goal_angle=goal_angle,
            finished=arrived & sequence.last,
            joint_jump=exceeds_joint_velocity(self.robot, before, arm.joint_positions, self.dt),
            time_scale=period.time_scale,
            collision=collision,
        )
        self._replan()
        stops = sequence.advance(arrived, arrived & (goal_distance <= GRASP_METRES))
        self._grip(step.subgoal, stops | step.finished)
        self.periods += 1
        if self.target_stream is not None:
            self.sequence.aim(self.target_stream.targets(self, np.arange(len(twist))))
            self.sequence.begin_again(np.flatnonzero(self.time_scale == 0.0))
        self._observe()
        return step

    def prepare(self) -> None:
        """Plan the next period ahead of the measurement that ends this one, where nothing changes.

        For backends, while a robot moves: the step after the measurement is shorter then.
        """
        if self.target_stream is None:
            self.observer.prepare()

    def measure(self, state: RobotState) -> None:
        """Continue from a newer measurement of robots that have not moved."""
        self._measure(state)
        self._observe()

    def slow_down(self, time_scale: Array) -> None:
        """Let this step carry out shares, shape (n,), of its planned motion; for filters."""
        period, sequence = self.period, self.sequence
        period.time_scale, period.solved = time_scale, None
        period.plan = sequence.plan(self._motion_time * time_scale)
        period.desired = sequence.next_desired(period.plan, period.paused)

    def snapshot(self) -> dict[str, NDArray[Any]]:
        """Return the whole state as arrays by name."""
        backend, stream = self._resumable, self.target_stream
        state = {**self.kinematic_state(), **backend.snapshot()}
        if stream is not None:
            targets = {f"{_TARGETS}{key}": values for key, values in stream.snapshot().items()}
            state |= {"time_scale": self.time_scale, **targets}
        return state

    def kinematic_state(self) -> dict[str, NDArray[Any]]:
        """Return the state without the backend's own: that of a loop in the analytic world."""
        return {
            **self.obstacles.snapshot(),
            "base_pose": self.state.base_pose,
            "joint_positions": self.state.joint_positions,
            "joint_command": self.joint_command,
            "previous_command": self.previous_command,
            "periods": self.periods.copy(),
            "waited": self._waited.copy(),
            **self.sequence.snapshot(),
        }

    def restore(self, snapshot: Mapping[str, NDArray[Any]]) -> None:
        """Continue from a state that `snapshot` returned."""
        backend = self._resumable
        self.sequence.restore(snapshot)
        self._measure(backend.restore(snapshot))
        if (solids := self.obstacles.after(0.0)) is not None:
            self.sequence.avoid(solids, _NO_ROWS)
        self.joint_command = snapshot["joint_command"].copy()
        self.previous_command = snapshot["previous_command"].copy()
        self.periods, self._waited = snapshot["periods"].copy(), snapshot["waited"].copy()
        self.time_scale = np.ones(len(self.joint_command))
        if self.target_stream is not None:
            self.time_scale = snapshot["time_scale"].copy()
            given = {k: v for k, v in snapshot.items() if k.startswith(_TARGETS)}
            self.target_stream.restore({k.removeprefix(_TARGETS): v for k, v in given.items()})
        self._observe()

    @property
    def action_size(self) -> int:
        """Count of numbers in the policy's action."""
        return action_size(self.robot, self.action_terms)

    @property
    def command_size(self) -> int:
        """Count of numbers that command the base."""
        return command_size(self.robot.base)

    @property
    def desired(self) -> Array:
        """Desired world pose of the EE now, shape (n, 7)."""
        return self.sequence.desired

    @property
    def true_state(self) -> tuple[Array, Array]:
        """World poses of base and EE, shape (n, 7) each: the true ones if the backend has them."""
        true_state = self.state.true_state
        if true_state is None:
            return self.state.base_pose, self.ee_pose
        return true_state.base_pose, spatial.compose(true_state.base_pose, self._ee_of(true_state))

    @property
    def _resumable(self) -> Resumable:
        if not isinstance(self.backend, Resumable):
            raise KinfeasError(
                f"{type(self.backend).__name__} does not support saving and resuming"
            )
        return self.backend

    def _replan(self) -> None:
        """Plan motions around solids that have moved; sub-goals that begin now avoid them, too."""
        solids = self.obstacles.after(0.0)
        if solids is not None and self.sequence.avoids_solids:
            rows, moving = _NO_ROWS, self.obstacles.moving
            if moving.any():
                due = self.periods % max(1, round(_REPLAN_SECONDS / self.dt)) == 0
                rows = np.flatnonzero(due & moving & (self.periods > 0))
            robots = self.state.base_pose, self.state.joint_positions
            self.sequence.avoid(solids, rows, robots)

    def _check(self, method: str, state: RobotState, n: int) -> None:
        check_state(state, n, len(self.robot.arm), f"{self._note.plugin}: {method}")

    def _measure(self, state: RobotState) -> None:
        self.state = state
        self._ee_in_base = self._ee_of(state)
        self.ee_pose = spatial.compose(state.base_pose, self._ee_in_base)

    def _ee_of(self, state: RobotState) -> Array:
        if state.ee_in_base is not None:
            return state.ee_in_base
        return forward(self.solver.chain, state.joint_positions)

    def _begin_period(self, torso: Array | None) -> Period:
        """Return the next period before any filter; torso velocities are shares, (n,)."""
        plan = self.observer.plan
        paused = self._find_paused()
        return Period(
            base_pose=self.state.base_pose,
            joints=self._with_torso(torso, paused),
            desired=self.sequence.next_desired(plan, paused),
            solids=self.obstacles.after(self.dt),
            guide=self.sequence.planned_joints,
            plan=plan,
            time_scale=np.ones(len(self.joint_command)),
            paused=paused,
        )

    def _filtered(self, command: Array) -> Array:
        """Return the commands after all filters, shape (n, a); those of paused rows are zero."""
        command = self.period.unless_paused(command)
        for one in self.filters:
            name = f"command filter {type(one).__name__}"
            with plugin_note(name):
                changed = one(command, self.policy_input)
            check_array(changed, command.shape, name)
            command = self.period.unless_paused(changed)
        return command

    def _with_torso(self, velocity: Array | None, paused: NDArray[np.bool_] | None) -> Array:
        """Return the joints at which IK begins, (n, j); torso velocities are shares, (n,)."""
        step, joints = self.kinematic_step, self.joint_command
        torso, step.hold_torso = self.robot.torso, velocity is not None
        if velocity is not None and torso is not None:
            lower, upper = self.robot.joint_limits
            joints, way = joints.copy(), velocity * step.max_joint_step[torso]
            if paused is not None:
                way = np.where(paused, 0.0, way)
            # One that is measured beyond a limit must not jump to it.
            low = np.minimum(lower[torso], joints[:, torso])
            high = np.maximum(upper[torso], joints[:, torso])
            joints[:, torso] = np.clip(joints[:, torso] + way, low, high)
        return joints

    def _solve(self, command: Array) -> tuple[Array, IkSolution]:
        """Return base twists, shape (n, 6), and arm joints that reach the desired poses."""
        solved = self.period.solved
        if solved is not None and (solved[0] is command or np.array_equal(solved[0], command)):
            return solved[1:]
        return self.kinematic_step(command, self.period)

    def _grip(self, subgoal: NDArray[np.intp], stops: NDArray[np.bool_]) -> None:
        """Command the grippers of rows whose sub-goals have just ended."""
        if self._gripper is None or not stops.any():
            return
        for number, one in enumerate(self.sequence.subgoals):
            rows = np.flatnonzero(stops & (subgoal == number))
            if one.grip is not None and rows.size:
                self._gripper.grip(one.grip, rows)

    def _observe(self) -> None:
        """Observe the robots and what comes next."""
        state, sequence = self.state, self.sequence
        observation = self.observer.observe(
            state.base_pose, self._ee_in_base, state.joint_positions, self.previous_command
        )
        self.policy_input = PolicyInput(
            observation=observation,
            base_pose=state.base_pose,
            ee_pose=self.ee_pose,
            joint_positions=state.joint_positions,
            desired=self.desired,
            planned=self.observer.planned,
            demonstrated_base=sequence.demonstrated_base,
            planned_base=sequence.planned_base,
        )

    def _find_paused(self) -> NDArray[np.bool_] | None:
        """Return which rows pause in this period, shape (n,), since their arms reconfigure.

        None if none does. Policies are trained with arms at their commands. During a
        reconfiguration they would read a large tracking error and drive the base after the EE.
        """
        if not self._arm_settle_timeout:
            return None
        way = self.state.joint_positions, self.joint_command
        reconfigures = exceeds_joint_velocity(self.robot, *way, RECONFIGURATION_SECONDS)
        self._waited = np.where(reconfigures, self._waited + 1, 0)
        paused = reconfigures & (self._waited <= self._arm_settle_timeout)
        return paused if paused.any() else None
