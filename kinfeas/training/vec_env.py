"""Vector environments for Stable-Baselines3: episodes in a thread or in worker processes."""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv

from kinfeas.control import observation
from kinfeas.core.checks import check_array
from kinfeas.core.errors import KinfeasError
from kinfeas.envs.episodes import WorkerContext, terminate, workers_alive
from kinfeas.envs.world import Batch, BatchStep, World
from kinfeas.kinematics.drive import command_size
from kinfeas.robots.loading import load_robot
from kinfeas.robots.robot import Robot
from kinfeas.training.config import TrainConfig
from kinfeas.training.worlds import begin_batch, call_batch, training_world

SHARE = 10**9
"""Episode numbers of each process: process i runs episodes `SHARE * i`, `SHARE * i + 1`, ..."""


class EpisodesVecEnv(VecEnv):
    """Episodes of one robot that restart by themselves, in batches that workers step.

    Stable-Baselines3's own vector environments hold one episode a process; these hold a batch.
    Observations are multiplied by `scale`, shape (d,). Each worker has its own episode numbers, so
    that a run is the same to the bit however fast the workers are.
    """

    render_mode = None

    def __init__(
        self,
        robot: Robot,
        terms: Sequence[str],
        sizes: Sequence[int],
        workers: Sequence[Executor],
        call: Callable[..., Any],
    ) -> None:
        """Set the spaces for one batch per worker; `sizes` are their numbers of episodes.

        `terms` are those of the observation. `call(method, *arguments)` calls a method of the
        worker's batch.
        """
        super().__init__(
            sum(sizes),
            spaces.Box(-np.inf, np.inf, (observation.size(robot, terms),), np.float32),
            spaces.Box(-1.0, 1.0, (command_size(robot.base),), np.float32),
        )
        self.robot = robot
        self.observation_terms = tuple(terms)
        self.scale = observation.scale(robot, terms).astype(np.float32)
        ends = np.cumsum(sizes)
        self._rows = [slice(end - size, end) for end, size in zip(ends, sizes, strict=True)]
        self._workers, self._call = list(workers), call
        self._coming: list[Future[Any]] = []

    def reset(self) -> NDArray[np.float32]:
        """Begin fresh episodes everywhere and return their observations, shape (n, d)."""
        return self._scaled(self._ask("start"))

    def step_async(self, actions: NDArray[Any]) -> None:
        """Begin a step with the actions, shape (n, a).

        Raises:
            KinfeasError: If the actions are of another shape or not finite.
        """
        assert self.action_space.shape is not None
        # A copy, since the caller may change the actions during the step.
        commands = np.array(actions, dtype=np.float64)
        check_array(commands, (self.num_envs, *self.action_space.shape), "the action")
        self._begin("step", *[[commands[rows]] for rows in self._rows])

    def step_wait(
        self,
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """Return observations, rewards, dones and infos; where done, a new episode has begun."""
        steps: list[BatchStep] = self._results()
        dones = np.zeros(self.num_envs, dtype=np.bool_)
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for rows, step in zip(self._rows, steps, strict=True):
            for row, end in step.ends.items():
                dones[rows.start + row] = True
                infos[rows.start + row] = {
                    "terminal_observation": observation.scaled(end.observation, self.scale),
                    "TimeLimit.truncated": end.truncated,
                    "is_success": end.success,
                    "failures": end.failures,
                }
        rewards = np.concatenate([step.reward for step in steps]).astype(np.float32)
        return self._scaled([step.observation for step in steps]), rewards, dones, infos

    def snapshot(self) -> dict[str, NDArray[Any]]:
        """Return the state to resume from, by name: the next episode of each worker."""
        return {"next_episode": np.array(self._ask("number"))}

    def restore(self, snapshot: Mapping[str, NDArray[Any]]) -> NDArray[np.float32]:
        """Resume from a snapshot and return the observations, shape (n, d)."""
        numbers = [[{"next_episode": number}] for number in snapshot["next_episode"]]
        return self._scaled(self._ask("restore", *numbers))

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Use another seed, and its first episodes, from the next reset on."""
        if seed is not None:
            self._ask("seed", *[(seed, SHARE * i) for i in range(len(self._workers))])
        return [seed] * self.num_envs

    def close(self) -> None:
        """End the workers; a step in progress ends first."""
        for worker in self._workers:
            worker.shutdown(cancel_futures=True)

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return an attribute once for each of the environments."""
        return [getattr(self, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Raise NotImplementedError: the environments share their attributes."""
        raise NotImplementedError("the environments of a world share their attributes")

    def env_method(
        self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any
    ) -> list[Any]:
        """Raise NotImplementedError: the environments have no methods of their own."""
        raise NotImplementedError("the environments of a world have no methods of their own")

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:
        """Return False for each of the environments."""
        return [False for _ in self._get_indices(indices)]

    def _begin(self, method: str, *arguments: Sequence[Any]) -> None:
        """Begin to call a method of each worker's batch, with the worker's own arguments."""
        with workers_alive(len(self._workers)):
            self._coming = [
                worker.submit(self._call, method, *inputs)
                for worker, inputs in zip(self._workers, arguments, strict=True)
            ]

    def _results(self) -> list[Any]:
        coming, self._coming = self._coming, []
        with workers_alive(len(self._workers)):
            return [future.result() for future in coming]

    def _scaled(self, parts: Sequence[NDArray[np.float64]]) -> NDArray[np.float32]:
        return observation.scaled(np.concatenate(parts), self.scale)

    def _ask(self, method: str, *arguments: Sequence[Any]) -> list[Any]:
        self._begin(method, *(arguments or [()] * len(self._workers)))
        return self._results()


class WorldVecEnv(EpisodesVecEnv):
    """n episodes in one world, which a thread steps while the learner works; see `Batch`.

    Snapshots hold the state of the world, too.
    """

    def __init__(self, world: World, num_envs: int, action_repeat: int = 1) -> None:
        if num_envs < 1:
            raise KinfeasError(f"num_envs must be at least 1, not {num_envs}")
        self.world, self.batch = world, Batch(world, num_envs, action_repeat)
        terms = world.loop.observer.terms
        super().__init__(world.robot, terms, [num_envs], [ThreadPoolExecutor(1)], self._call_batch)

    def snapshot(self) -> dict[str, NDArray[Any]]:
        """Return the state to resume from, by name."""
        return self.batch.snapshot()

    def restore(self, snapshot: Mapping[str, NDArray[Any]]) -> NDArray[np.float32]:
        """Resume from a snapshot and return the observations, shape (n, d)."""
        return self._scaled([self.batch.restore(snapshot)])

    def close(self) -> None:
        """End the thread and close the world's backend."""
        super().close()
        self.world.close()

    def _call_batch(self, method: str, *arguments: Any) -> Any:
        return getattr(self.batch, method)(*arguments)


class ProcessVecEnv(EpisodesVecEnv):
    """Episodes in physics worlds, a batch in each of a few processes."""

    def __init__(self, config: TrainConfig) -> None:
        """Start the processes and build their worlds."""
        parts = np.array_split(np.arange(config.num_envs), config.processes)
        self._pools = [
            ProcessPoolExecutor(1, WorkerContext(), begin_batch, (config, len(part), SHARE * i))
            for i, part in enumerate(parts)
        ]
        sizes = [len(part) for part in parts]
        terms = config.observation
        super().__init__(load_robot(config.robot), terms, sizes, self._pools, call_batch)
        try:
            self._ask("number")
        except KinfeasError:
            self.close()
            raise

    def close(self) -> None:
        """End the processes at once; a step in progress is lost."""
        for pool in self._pools:
            terminate(pool)


def environments(config: TrainConfig) -> EpisodesVecEnv:
    """Return the environments of a run or of a part of it."""
    if config.processes > 1:
        return ProcessVecEnv(config)
    return WorldVecEnv(training_world(config), config.num_envs, config.action_repeat)
