"""Episodes with physics: processes that hold some PyBullet worlds each."""

import multiprocessing
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinfeas.core.errors import KinfeasError
from kinfeas.robots.loading import load_robot
from kinfeas.training.batch import StepResult
from kinfeas.training.config import TrainConfig
from kinfeas.training.process_world import serve
from kinfeas.training.vec_env import EpisodesVecEnv

SHARE = 10**9
"""Episodes of the seed that each process takes, one after the other, from its own part on."""

_CLOSE_SECONDS = 5.0


class ProcessVecEnv(EpisodesVecEnv):
    """Processes with some robots each, in PyBullet worlds, and one batched loop around them.

    Process i runs episodes `SHARE * i`, `SHARE * i + 1` and so on, however fast the others are: a
    training run is the same to the bit whatever else the machine does.
    """

    def __init__(self, config: TrainConfig) -> None:
        """Start the processes and build their worlds.

        Raises:
            KinfeasError: If a world cannot be built.
        """
        super().__init__(load_robot(config.robot), config.num_envs)
        context = multiprocessing.get_context("spawn")
        self._pipes: list[Connection] = []
        self._processes = []
        self._under_way = False
        self._next = np.arange(config.processes) * SHARE
        parts = np.array_split(np.arange(config.num_envs), config.processes)
        self._rows = [slice(part[0], part[-1] + 1) for part in parts]
        for part in parts:
            pipe, end = context.Pipe()
            process = context.Process(target=serve, args=(end, config, len(part)), daemon=True)
            process.start()
            end.close()
            self._pipes.append(pipe)
            self._processes.append(process)
        try:
            self._answers()
        except KinfeasError:
            self.close()
            raise

    def reset(self) -> NDArray[np.float32]:
        """Begin fresh episodes everywhere and return their observations, shape (n, d)."""
        return self._begin(self._next)

    def step_async(self, actions: NDArray[Any]) -> None:
        """Begin a step with the actions, shape (n, a)."""
        actions = np.asarray(actions, dtype=np.float64)
        self._ask([("step", actions[rows]) for rows in self._rows])
        self._under_way = True

    def step_wait(self) -> StepResult:
        """Return observations, rewards, dones and infos; where done, a new episode has begun."""
        if not self._under_way:
            raise RuntimeError("step_wait needs a step_async before it")
        self._under_way = False
        answers = self._answers()
        steps = [step for step, _ in answers]
        self._next = np.array([number for _, number in answers])
        seen, rewards, dones = (np.concatenate([one[i] for one in steps]) for i in range(3))
        return seen, rewards, dones, [info for one in steps for info in one[3]]

    def snapshot(self) -> dict[str, NDArray[Any]]:
        """Return which episodes come next: physics itself cannot be put into arrays."""
        if self._under_way:
            self.step_wait()
        return {"next_episode": self._next.copy()}

    def restore(self, snapshot: Mapping[str, NDArray[Any]]) -> NDArray[np.float32]:
        """Begin the episodes after those of `snapshot`; return the observations, shape (n, d)."""
        numbers = snapshot["next_episode"]
        if len(numbers) != len(self._rows):
            raise ValueError(f"a snapshot of {len(numbers)}, not {len(self._rows)} processes")
        if numbers.min() < 0:
            raise ValueError(f"a snapshot whose next episodes are {numbers.tolist()}")
        return self._begin(numbers)

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Do nothing: the processes go by the seed of their configuration."""
        return [seed] * self.num_envs

    def close(self) -> None:
        """End the processes."""
        for pipe in self._pipes:
            pipe.close()
        for process in self._processes:
            process.join(_CLOSE_SECONDS)
            if process.is_alive():
                process.terminate()

    def _begin(self, numbers: NDArray[np.intp]) -> NDArray[np.float32]:
        self._ask([("begin", int(number)) for number in numbers])
        answers = self._answers()
        self._next = np.array([number for _, number in answers])
        return np.concatenate([seen for seen, _ in answers])

    def _ask(self, questions: Sequence[tuple[str, Any]]) -> None:
        with _alive(len(self._rows)):
            for pipe, question in zip(self._pipes, questions, strict=True):
                pipe.send(question)

    def _answers(self) -> list[Any]:
        with _alive(len(self._rows)):
            answers = [pipe.recv() for pipe in self._pipes]
        for answer in answers:
            if isinstance(answer, KinfeasError):
                raise answer
        return answers


@contextmanager
def _alive(count: int) -> Iterator[None]:
    try:
        yield
    except (EOFError, OSError) as error:
        raise KinfeasError(
            f"one of {count} training processes died, as if killed or out of memory; "
            "try fewer --processes"
        ) from error
