"""The Markov decision process: the loop plus reward, restarts and ends of episodes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray

from kinfeas.config import PluginSpec, from_mapping
from kinfeas.config.recipes import section
from kinfeas.control.assemble import assemble, build_simulator, respond_late
from kinfeas.control.execution import ExecutionConfig
from kinfeas.control.loop import Outcome
from kinfeas.core.backend import closed_on_error
from kinfeas.core.checks import check_array
from kinfeas.core.errors import plugin_note
from kinfeas.core.motion import Rows, with_rows
from kinfeas.core.quantities import ControlPeriod, PositiveSeconds
from kinfeas.core.spatial import Array
from kinfeas.core.start import episode_rng, stacked
from kinfeas.envs.reward import RewardConfig, reward
from kinfeas.kinematics.ik import IkOptions, IkSolver
from kinfeas.robots.robot import Robot
from kinfeas.tasks.task import (
    StagedTask,
    StreamTask,
    Task,
    build_subgoals,
    sample_start,
    target_stream,
)


@dataclass(frozen=True)
class WorldConfig(ExecutionConfig):
    """Settings of a world besides robot and task; see `ExecutionConfig` for those of motions."""

    dt: ControlPeriod = 0.1  # control period, seconds
    # steps without an IK solution in one episode beyond which it ends
    max_failures: Annotated[int, Interval(ge=0)] = 19
    # motion time of one sub-goal, its dwell included, after which an episode is truncated
    max_seconds: PositiveSeconds = 300.0
    adapters: tuple[PluginSpec, ...] = ()  # adapters around the backend, the first one innermost
    reward: RewardConfig = field(default_factory=RewardConfig)  # weights of the reward
    ik: IkOptions = field(default_factory=IkOptions)  # search effort of IK
    filters: tuple[PluginSpec, ...] = ()  # filters of the policy's commands, in this order
    backend: str = "analytic"  # entry point in the group kinfeas.backends
    # keyword parameters of the backend
    backend_parameters: dict[str, object] = field(default_factory=dict)

    @property
    def late(self) -> bool:
        """Whether robots respond late, because of `response` or an adapter."""
        return super().late or respond_late(self.adapters)


def evaluation_section(backend: str, robot: str | Path | None) -> tuple[dict[str, Any], str]:
    """Return the settings of the evaluations of a robot as plain data, and their source.

    A backend without a section has the defaults.
    """
    data, source = section(backend, robot)
    return {**data, "world": {"backend": backend, **data.get("world", {})}}, source


def evaluation_world(backend: str = "analytic", robot: str | Path | None = None) -> WorldConfig:
    """Return the settings in which the policies of a robot are evaluated."""
    data, source = evaluation_section(backend, robot)
    return from_mapping(WorldConfig, data["world"], source)


@dataclass(frozen=True)
class Transition:
    """The result of a step of n episodes; arrays have the leading shape (n,)."""

    observation: Array  # shape (n, d)
    reward: Array  # reward of the step
    # whether the episode ended by success, by too many failures, or by a collision of the base
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]  # whether it ended by the time limit
    # whether the last sub-goal was reached on a feasible step, or the end of a stream of targets
    reached: NDArray[np.bool_]
    outcome: Outcome  # result of the loop's step
    # true path length of the EE in the step, metres; this and the next only for streams of targets
    path_length: Array | None = None
    planned_length: Array | None = None  # path length that the stream asks for, metres

    @property
    def done(self) -> NDArray[np.bool_]:
        """Whether the episode ended either way, shape (n,)."""
        return self.terminated | self.truncated


class World:
    """n episodes of one task side by side, without automatic restarts.

    Episode k of seed s is the same to the bit in any batch: its randomness depends only on s, k and
    the stream.

    Attributes:
        task: The task, as the backend has set it up.
        backend: The backend within the adapters.
        next_episode: Number of the episode that `start_next` begins next.
        stream: Separates episodes of a seed from those with equal numbers; empty in evaluations.
    """

    next_episode: int = 0
    stream: tuple[int, ...] = ()

    def __init__(self, robot: Robot, task: Task, config: WorldConfig, seed: int) -> None:
        """Build a world whose episodes have one seed.

        Raises:
            KinfeasError: If backend, task or an adapter cannot be built, or the backend is a robot.
        """
        self.robot, self.config, self.seed = robot, config, seed
        self.solver = IkSolver(robot, config.ik)
        self.backend = build_simulator(config.backend, config.backend_parameters, robot=robot)
        self.task = task
        with closed_on_error(self.backend):
            if self.backend.staging is not None:
                self.task = self.backend.staging.stage(task)
            self._staged = isinstance(self.task, StagedTask)
            self.loop = assemble(
                self.solver, build_subgoals(task.subgoals), self.backend, dt=config.dt,
                execution=config, adapters=config.adapters, filters=config.filters,
                stream=target_stream(task, self.solver),
            )  # fmt: skip
        seconds = config.max_seconds / self.loop.execution.time_scale
        if isinstance(task, StreamTask):
            seconds = task.seconds
        self._max_steps = max(1, round(seconds / config.dt))
        self.failures: NDArray[np.intp] = np.empty(0, dtype=np.intp)
        self.steps: NDArray[np.intp] = np.empty(0, dtype=np.intp)

    @property
    def action_size(self) -> int:
        """Length of an action."""
        return self.loop.command_size

    def rng(self, episode: int) -> np.random.Generator:
        """Return the random generator of an episode, at its beginning."""
        return episode_rng(self.seed, episode, self.stream)

    def start(self, episodes: Sequence[int], rows: Rows | None = None) -> Array:
        """Begin episodes by number and return the observation of all n, shape (n, d).

        They begin in `rows`; by default in all, which also sets n.
        """
        rngs = [self.rng(episode) for episode in episodes]
        indices = range(len(episodes)) if rows is None else rows.tolist()
        if not self._staged:
            indices = [None] * len(episodes)
        starts = [
            sample_start(self.task, self.solver, rng, row)
            for rng, row in zip(rngs, indices, strict=True)
        ]
        self.loop.start(stacked(starts), rngs, rows)
        failures, steps = np.zeros((2, len(episodes)), dtype=np.intp)
        self.failures = with_rows(self.failures, rows, failures)
        self.steps = with_rows(self.steps, rows, steps)
        return self.loop.observation.values

    def start_next(self, count: int, rows: Rows | None = None) -> Array:
        """Begin the next `count` episodes, as `start` does."""
        first, self.next_episode = self.next_episode, self.next_episode + count
        return self.start(range(first, self.next_episode), rows)

    def step(self, action: Array | None = None) -> Transition:
        """Advance all n episodes by one control period.

        The action, shape (n, a), is clipped to [-1, 1]; by default it is the policy's.

        Raises:
            KinfeasError: If the action has another shape or is not finite.
        """
        loop = self.loop
        if action is not None:
            check_array(action, (len(self.steps), self.action_size), "the action")
        path_length = planned_length = None
        if loop.stream is not None:
            before = loop.true_state[1]
            planned_length = loop.stream.speed * loop.dt * loop.execution.time_scale
        outcome = loop.step(action)
        self.steps += 1
        self.steps[loop.sequence.subgoal != outcome.subgoal] = 0
        self.failures += ~outcome.feasible
        terminated = outcome.finished | (self.failures > self.config.max_failures)
        reached = outcome.finished
        if outcome.collision is not None:
            terminated |= outcome.collision[:, 0]
            reached = reached & ~outcome.collision[:, 0]
        truncated = (self.steps >= self._max_steps) & ~terminated
        if loop.stream is not None:
            path_length = np.linalg.norm((loop.true_state[1] - before)[:, :3], axis=1)
            reached = truncated
        joints, base_error = loop.robots.joint_positions, loop.observer.base_error
        earned = reward(self.config.reward, self.robot, outcome, loop.action, joints, base_error)
        return Transition(
            observation=loop.observation.values, reward=earned, terminated=terminated,
            truncated=truncated, reached=reached, outcome=outcome, path_length=path_length,
            planned_length=planned_length,
        )  # fmt: skip

    def close(self) -> None:
        """Close the backend; it may be called twice."""
        with plugin_note(f"backend {self.loop.backend.name}"):
            self.loop.backend.close()

    def snapshot(self) -> dict[str, NDArray[Any]]:
        """Return the state of the n episodes by name."""
        # `step` counts in place.
        counts = {"failures": self.failures.copy(), "steps": self.steps.copy()}
        return {**self.loop.snapshot(), **counts}

    def restore(self, snapshot: Mapping[str, NDArray[Any]]) -> Array:
        """Continue from a `snapshot` and return the observation, shape (n, d)."""
        self.loop.restore(snapshot)
        self.failures, self.steps = snapshot["failures"].copy(), snapshot["steps"].copy()
        return self.loop.observation.values


class End(NamedTuple):
    """The end of an episode."""

    observation: Array  # last observation, shape (d,)
    truncated: bool  # whether it ended by the time limit
    success: bool  # whether the goal was reached without a failure
    failures: int  # steps without an IK solution


class BatchStep(NamedTuple):
    """The result of a step of n episodes."""

    observation: Array  # observations, shape (n, d); of the next episode where one has ended
    reward: Array  # mean reward of the control periods of the action, shape (n,)
    ends: dict[int, End]  # ends of episodes by row
    infos: dict[str, NDArray[Any]]  # from `step_info` before restarts; empty without `Batch.infos`


@dataclass
class Batch:
    """n episodes in one world, which restart by themselves.

    An action is repeated for `action_repeat` control periods and earns their mean reward. If an
    episode ends within them, the mean is over the periods until its end; the next one begins after
    the last period.
    """

    world: World
    size: int
    action_repeat: int = 1
    infos: bool = False

    def start(self) -> Array:
        """Begin new episodes in all rows and return their observations, shape (n, d)."""
        return self.world.start_next(self.size)

    def step(self, actions: Array) -> BatchStep:
        """Step all episodes with commands in [-1, 1], shape (n, a)."""
        earned, periods = np.zeros(self.size), np.zeros(self.size)
        over = np.zeros(self.size, dtype=np.bool_)
        ends: dict[int, End] = {}
        for _ in range(self.action_repeat):
            # Rows whose episode is over are stepped along with the others, and ignored.
            transition = self.world.step(actions)
            earned += np.where(over, 0.0, transition.reward)
            periods += ~over
            for row in np.flatnonzero(transition.done & ~over).tolist():
                failures = int(self.world.failures[row])
                success = bool(transition.reached[row]) and failures == 0
                last = transition.observation[row].copy()
                ends[row] = End(last, bool(transition.truncated[row]), success, failures)
            over |= transition.done
            if over.all():
                break
        infos = step_info(self.world, transition) if self.infos else {}
        observation = self.world.loop.observation.values
        if ends:
            rows = np.array(sorted(ends))
            observation = self.world.start_next(rows.size, rows)
        return BatchStep(observation, earned / periods, ends, infos)

    def seed(self, seed: int, first: int) -> None:
        """Begin with the episode `first` of another seed at the next start."""
        self.world.seed, self.world.next_episode = seed, first

    def number(self) -> int:
        """Return the number of the next episode."""
        return self.world.next_episode

    def snapshot(self) -> dict[str, NDArray[Any]]:
        """Return the state to resume from, by name."""
        world = self.world.snapshot() if self.world.loop.resumable else {}
        return {**world, "next_episode": np.array(self.number())}

    def restore(self, snapshot: Mapping[str, NDArray[Any]]) -> Array:
        """Resume from a snapshot and return the observations, shape (n, d).

        Without a state of the world the next episodes begin.
        """
        self.world.next_episode = int(snapshot["next_episode"])
        if self.world.loop.resumable and snapshot.keys() > {"next_episode"}:
            return self.world.restore(snapshot)
        return self.start()


def step_info(world: World, transition: Transition) -> dict[str, NDArray[Any]]:
    """Return the infos of a step of n episodes by name, each of shape (n,).

    `failures` counts from the beginning of the episode; `is_success` is a goal reached without a
    failure. Backends that measure contacts add the numbers of contacts of base and arm.
    """
    outcome, failures = transition.outcome, world.failures.copy()
    info: dict[str, NDArray[Any]] = {
        "subgoal": outcome.subgoal, "feasible": outcome.feasible, "failures": failures,
        "deviation": outcome.deviation, "goal_distance": outcome.goal_distance,
        "goal_angle": outcome.goal_angle, "joint_jump": outcome.joint_jump,
        "reached": transition.reached, "is_success": transition.reached & (failures == 0),
    }  # fmt: skip
    if (sensor := world.backend.contacts) is not None:
        contacts = [sensor.touching(row) for row in range(len(failures))]
        info["base_contacts"] = np.array([len(contact.base) for contact in contacts])
        info["arm_contacts"] = np.array([len(contact.arm) for contact in contacts])
    return info
