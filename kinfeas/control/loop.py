"""The loop: motion generator, policy, command filters, IK and backend, n robots at a time."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinfeas.control.execution import ExecutionConfig
from kinfeas.control.observation import OBSERVATION, check_terms
from kinfeas.control.observer import Observer
from kinfeas.control.period import (
    RECONFIGURATION_SECONDS,
    Arm,
    CommandFilter,
    Move,
    Period,
    check_time_scale,
)
from kinfeas.control.response import Predictor
from kinfeas.control.sequence import MotionSequence
from kinfeas.control.surroundings import Surroundings
from kinfeas.control.targets import TargetStream
from kinfeas.core import spatial
from kinfeas.core.backend import Backend, Resumable, RobotState
from kinfeas.core.checks import check_array, check_state
from kinfeas.core.errors import KinfeasError, plugin_note
from kinfeas.core.metrics import GOAL_METRES, GOAL_RADIANS
from kinfeas.core.motion import Rngs, Rows, with_rows
from kinfeas.core.policy import Observation, Policy
from kinfeas.core.response import ResponseModel
from kinfeas.core.spatial import Array
from kinfeas.core.start import Start
from kinfeas.kinematics.drive import command_size
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolver
from kinfeas.robots.robot import Robot, check_same_robot, exceeds_joint_velocity, fingerprint

_NO_ROWS: Rows = np.empty(0, dtype=np.intp)


@dataclass(frozen=True)
class Outcome:
    """Result of one step of the loop; each array has the leading shape (n,).

    The EE position that is due was desired one command latency of the response model ago; with a
    stream of targets, it is the one desired now. `collision` is None without solids, or if the loop
    does not detect collisions.
    """

    feasible: NDArray[np.bool_]  # whether IK found the desired pose
    position_error: Array  # from the desired pose to the IK solution or closest attempt, metres
    rotation_error: Array  # the same in radians
    deviation: Array  # of the EE from the position that is due, metres; the true one if measured
    tracking_error: Array  # the same in the frame of the robot's localisation
    subgoal: NDArray[np.intp]  # number of the sub-goal of this step
    goal_distance: Array  # distance of the achieved EE from the end of that sub-goal, metres
    goal_angle: Array  # the same in radians
    finished: NDArray[np.bool_]  # whether the last sub-goal was reached, on this feasible step
    joint_jump: NDArray[np.bool_]  # whether an arm joint was to move faster than its limit
    time_scale: Array  # fraction of the planned motion that was carried out
    collision: NDArray[np.bool_] | None = None  # whether base, then arm, touch solids, (n, 2)


class Loop:
    """n robots, each following its own EE motion; `assemble` builds one.

    Attributes:
        sequence: Desired motions of the EEs.
        dt: Control period, seconds.
        surroundings: Solids and scans, where the backend has them.
        observer: Observes the robots, with the terms of the policy.
        policy: Policy that commands the bases, or None if each step is given an action. Set it by
            `set_policy`.
        robots: State of the robots now.
        ee_pose: World poses of the EEs now, shape (n, 7).
        observation: Present input of the policy.
        action: Last action, before the filters, shape (n, a).
        previous_command: Last base commands, after the filters, shape (n, a).
        finds_collisions: Whether outcomes say which robots touch solids.
    """

    robots: RobotState
    ee_pose: Array
    observation: Observation
    action: Array
    finds_collisions: bool = True

    def __init__(  # noqa: PLR0913, PLR0917 - the parts of a loop
        self,
        solver: IkSolver,
        sequence: MotionSequence,
        backend: Backend,
        dt: float,
        execution: ExecutionConfig,
        response: ResponseModel,
        filters: Sequence[CommandFilter],
        build_filter: Callable[[str, Mapping[str, object]], CommandFilter],
    ) -> None:
        self.solver, self.sequence, self.backend, self.dt = solver, sequence, backend, dt
        self.execution, self.robot, self._build_filter = execution, solver.robot, build_filter
        self._note, self._unchecked = plugin_note(f"backend {backend.name}"), True
        self._loop_filters = tuple(filters)
        self._use_filters(filters)
        self.policy: Policy | None = None
        self._policy_note = plugin_note("policy")
        self.surroundings = Surroundings(backend, solver.collision)
        self.observer = Observer(sequence, self.surroundings, backend.obstacles, dt, execution)
        self._arm = Arm(solver, dt, response, execution.arm_settle_timeout)
        self._predictor = None if response.immediate else Predictor(response, solver, dt)
        if self._predictor is not None:
            sequence.lead = self._predictor.base.lead(dt) / dt
            sequence.delay = self._predictor.delay
        self.previous_command: Array = np.empty((0, self.command_size))

    def set_policy(self, policy: Policy) -> None:
        """Use a policy: its terms, its filters, and its `reset` at each start if it has one.

        Raises:
            KinfeasError: If the policy is for another robot, a term is unknown or there twice, or a
                filter is unknown.
        """
        name, own_robot = f"policy {type(policy).__name__}", getattr(policy, "robot", None)
        if isinstance(own_robot, Robot) and own_robot is not self.robot:
            check_same_robot(self.robot, own_robot.name, fingerprint(own_robot), name)
        terms = getattr(policy, "observation_terms", OBSERVATION)
        if terms not in ((), []):
            terms = check_terms(terms, f"{name}: 'observation_terms'")
        self.policy, self.observer.terms = policy, tuple(terms)
        self._policy_note = plugin_note(name)
        names = getattr(policy, "filters", ()) if self.stream is None else ()
        own = [self._build_filter(name, {}) for name in names]
        kinds = [type(command_filter) for command_filter in self._loop_filters]
        self._use_filters((*(each for each in own if type(each) not in kinds), *self._loop_filters))

    def start(self, start: Start, rngs: Rngs, rows: Rows | None = None) -> None:
        """Begin new episodes.

        Args:
            start: Starts of the m episodes.
            rngs: One source of randomness for each of them.
            rows: Which of the n robots begin anew; all of them by default, which also sets n.
        """
        # Drawn even if no adapter needs them, so that adapters do not change the motions.
        seeds = np.array([rng.integers(2**64, dtype=np.uint64) for rng in rngs])
        fresh = np.arange(len(rngs)) if rows is None else rows
        n = len(rngs) if rows is None else len(self.previous_command)
        with self._note:
            self.backend.seed(seeds, fresh)
            robots = self.backend.reset(start.base_pose, start.joint_positions, rows)
            self.surroundings.place(start.solids, fresh)
        self._check("reset", robots, n)
        self._unchecked = True
        if self._predictor is not None:
            robots = self._predictor.start(robots, rows)
        ee = spatial.compose(start.base_pose, forward(self.solver.chain, start.joint_positions))
        self.sequence.start(ee, start.target_poses, rngs, rows)
        self._measure(robots)
        if (solids := self.surroundings.after(0.0)) is not None:
            self.sequence.avoid(solids, fresh, (robots.base_pose, robots.joint_positions))
        rest = np.zeros((len(rngs), self.command_size))
        self.previous_command = with_rows(self.previous_command, rows, rest)
        self._arm.start(robots.joint_positions, rows)
        self.sequence.start_stream(rngs, fresh, robots.base_pose)
        self._observe()
        parts = (self.policy, *self.filters)
        for part, note in zip(parts, (self._policy_note, *self._notes), strict=True):
            if (reset := getattr(part, "reset", None)) is not None:
                with note:
                    reset(fresh, n)

    def step(self, action: Array | None = None) -> Outcome:
        """Advance all robots by one control period.

        A sub-goal ends on a feasible step that brings the EE to its goal; a motion along a path of
        its own must also be at the end of the path. The next sub-goal begins at the desired pose,
        after the dwell time.

        Args:
            action: Base commands, clipped to [-1, 1], shape (n, a); those of the policy by default.

        Raises:
            KinfeasError: If the policy or a filter returns another shape or numbers that are not
                finite, or a filter writes into the period; that is checked after each start.
        """
        sequence, joints_before = self.sequence, self._arm.joint_command
        self.action = (self._policy_action() if action is None else action).clip(-1.0, 1.0)
        period = self._period()
        for command_filter, note in zip(self.filters, self._notes, strict=True):
            copies = _arrays(period) if self._unchecked else {}
            with note:
                changed: object = command_filter(period)
            for key, values in copies.items():
                if not np.array_equal(values, getattr(period, key), equal_nan=True):
                    raise KinfeasError(f"{note.plugin} must not write into {key!r} of the period")
            if not isinstance(changed, Period):
                kind = type(changed).__name__
                raise KinfeasError(f"{note.plugin} must return a Period, not a {kind}")
            shape = self.previous_command.shape
            check_array(changed.command, shape, f"{note.plugin}: the command")
            if changed.time_scale is not period.time_scale:
                check_time_scale(changed.time_scale, shape[:1], f"{note.plugin}: the time_scale")
            period = changed.commanded(changed.command)
        self.previous_command = period.command
        sequence.move(period.step, period.paused)
        move = self._arm(period)
        with self._note:
            robots = self.backend.step(move.base_twist, move.arm.joint_positions, self.dt)
        if self._unchecked:
            self._check("step", robots, len(period.command))
            self._unchecked = False
        if self._predictor is not None:
            self._predictor.command(move.base_twist, move.arm.joint_positions, sequence.desired)
            robots = self._predictor.predict(robots)
        self._measure(robots)
        outcome, arrived = self._outcome(period, move, joints_before)
        carried_out = np.where(period.motion_seconds > 0.0, period.time_scale, 0.0)
        sequence.advance(arrived, outcome.goal_distance, carried_out, robots, self.surroundings)
        self._observe()
        return outcome

    def prepare(self) -> None:
        """Compute the parts of the next period that need no measurement.

        Called while a real robot moves, so that the step after its measurement is shorter.
        """
        if self.sequence.stream is None:
            self.observer.prepare()

    def measure(self, robots: RobotState) -> None:
        """Continue from a newer measurement of robots that have not moved."""
        if self._predictor is not None:
            robots = self._predictor.start(robots)
        self._measure(robots)
        self._observe()

    def snapshot(self) -> dict[str, NDArray[Any]]:
        """Return the whole state as arrays by name."""
        return {
            "joint_command": self._arm.joint_command,
            "previous_command": self.previous_command,
            "waited": self._arm.waited.copy(),
            **self.sequence.snapshot(),
            **({} if self._predictor is None else self._predictor.snapshot()),
            **self._saver.snapshot(),
        }

    def restore(self, snapshot: Mapping[str, NDArray[Any]]) -> None:
        """Continue from a state that `snapshot` returned."""
        robots = self._saver.restore(snapshot)
        if self._predictor is not None:
            robots = self._predictor.restore(snapshot, robots)
        self.sequence.restore(snapshot)
        self._measure(robots)
        if (solids := self.surroundings.after(0.0)) is not None:
            self.sequence.avoid(solids, _NO_ROWS)
        self._arm.joint_command = snapshot["joint_command"].copy()
        self.previous_command = snapshot["previous_command"].copy()
        self._arm.waited = snapshot["waited"].copy()
        self._observe()

    @property
    def resumable(self) -> bool:
        """Whether `snapshot` holds the whole state; it lacks that of filters with a `reset`."""
        stateful = any(hasattr(each, "reset") for each in self.filters)
        return self.backend.resumable is not None and not stateful

    @property
    def command_size(self) -> int:
        """Count of numbers that command a base."""
        return command_size(self.robot.base)

    @property
    def response_sums(self) -> Array | None:
        """Sums of each episode for `metrics.lateness`, (n, 2); None for robots without delay."""
        return None if self._predictor is None else self._predictor.sums

    @property
    def stream(self) -> TargetStream | None:
        """Targets that move, if there are any."""
        return self.sequence.stream

    @property
    def desired(self) -> Array:
        """Desired world pose of the EE now, shape (n, 7)."""
        return self.sequence.desired

    @property
    def true_state(self) -> tuple[Array, Array]:
        """World poses of base and EE, shape (n, 7) each: the true ones if the backend has them."""
        true_state = self.robots.true_state
        if true_state is None:
            return self.robots.base_pose, self.ee_pose
        return true_state.base_pose, spatial.compose(true_state.base_pose, self._ee_of(true_state))

    @property
    def _saver(self) -> Resumable:
        if self.backend.resumable is None:
            raise KinfeasError(f"{self.backend.name} does not support saving and resuming")
        return self.backend.resumable

    def _policy_action(self) -> Array:
        assert self.policy is not None, "without a policy a step needs an action"
        with self._policy_note:
            action = self.policy.act(_read_only(self.observation))
        # Before a filter can replace it.
        check_array(action, self.previous_command.shape, f"{self._policy_note.plugin}: the action")
        return action

    def _period(self) -> Period:
        robots, step = self.robots, self.sequence.next_step
        paused = self._arm.pauses(robots.joint_positions)
        period = Period(
            command=self.action, base_pose=robots.base_pose, joints=self._arm.joint_command,
            desired=self.sequence.arm_target(step, paused), solids=self.surroundings.after(self.dt),
            posture_guide=self.sequence.planned.joints, step=step,
            time_scale=np.ones(len(self.action)), motions=self.sequence, paused=paused,
            motion=None if self._predictor is None else self._predictor.motion,
        )  # fmt: skip
        return period.commanded(period.command)

    def _outcome(
        self, period: Period, move: Move, before: Array
    ) -> tuple[Outcome, NDArray[np.bool_]]:
        """Return the result of a period, and which EEs are at the end of their sub-goal, (n,).

        `before` are the joint commands of the period before, shape (n, j).
        """
        sequence, arm = self.sequence, move.arm
        goal_distance, goal_angle = spatial.distance(self.ee_pose, sequence.goal)
        near = (goal_distance <= GOAL_METRES) & (goal_angle <= GOAL_RADIANS)
        arrived = sequence.ended(arm.feasible & near)
        deviation, localised = self._deviation(self.true_state[1]), self.robots.localised
        tracking = deviation
        if localised is not None:
            ee_in_base = self._ee_of(self.robots.true_state or self.robots)
            tracking = self._deviation(spatial.compose(localised, ee_in_base))
        paused, scale = period.paused, period.time_scale
        scale = scale if paused is None else np.where(paused, 0.0, scale)
        outcome = Outcome(
            feasible=arm.feasible,
            position_error=arm.position_error, rotation_error=arm.rotation_error,
            deviation=deviation, tracking_error=tracking,
            subgoal=sequence.subgoal, goal_distance=goal_distance, goal_angle=goal_angle,
            finished=arrived & sequence.last,
            joint_jump=exceeds_joint_velocity(self.robot, before, arm.joint_positions, self.dt),
            time_scale=scale,
            collision=self.surroundings.collisions(self.robots) if self.finds_collisions else None,
        )  # fmt: skip
        return outcome, arrived

    def _deviation(self, ee_pose: Array) -> Array:
        desired = self.sequence.desired[:, :3]
        if self._predictor is not None and self.stream is None:
            desired = self._predictor.due
        return np.linalg.norm(ee_pose[:, :3] - desired, axis=1)

    def _use_filters(self, filters: Sequence[CommandFilter]) -> None:
        self.filters = tuple(filters)
        self._notes = [plugin_note(f"command filter {type(each).__name__}") for each in filters]

    def _check(self, method: str, robots: RobotState, n: int) -> None:
        check_state(robots, n, len(self.robot.arm), f"{self._note.plugin}: {method}")

    def _measure(self, robots: RobotState) -> None:
        self.robots = robots
        self._ee_in_base = self._ee_of(robots)
        self.ee_pose = spatial.compose(robots.base_pose, self._ee_in_base)

    def _ee_of(self, robots: RobotState) -> Array:
        if robots.ee_in_base is not None:
            return robots.ee_in_base
        return forward(self.solver.chain, robots.joint_positions)

    def _observe(self) -> None:
        robots, ee_in_base, ee_pose = self.robots, self._ee_in_base, self.ee_pose
        if self._predictor is not None:
            # Policies are trained with arms at their commands.
            joints = self._arm.joint_command
            away = exceeds_joint_velocity(
                self.robot, robots.joint_positions, joints, RECONFIGURATION_SECONDS
            )
            joints = np.where(away[:, np.newaxis], robots.joint_positions, joints)
            ee_in_base = forward(self.solver.chain, joints)
            ee_pose = spatial.compose(robots.base_pose, ee_in_base)
            robots = replace(robots, joint_positions=joints)
        self.observation = self.observer.observe(robots, ee_in_base, ee_pose, self.previous_command)


def _arrays(period: Period) -> dict[str, NDArray[Any]]:
    """Return copies of the arrays of a period."""
    arrays = {key: value for key, value in vars(period).items() if isinstance(value, np.ndarray)}
    return {key: value.copy() for key, value in arrays.items()}


def _read_only(observation: Observation) -> Observation:
    """Return an observation with read-only arrays, except `values`, which only the policy uses.

    They are views. The arrays of the loop stay writable, since numba would compile kernels again
    for read-only ones.
    """
    fields = dict(vars(observation))
    for name, array in fields.items():
        if isinstance(array, np.ndarray) and name != "values":
            fields[name] = array.view()
            fields[name].flags.writeable = False
    return Observation(**fields)
