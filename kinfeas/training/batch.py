"""Episodes side by side that restart by themselves, in this or another process; without torch."""

import signal
from collections.abc import Mapping
from dataclasses import dataclass
from operator import methodcaller
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinfeas.control import observation
from kinfeas.core.motion import Rows
from kinfeas.envs.episodes import begin_worker
from kinfeas.envs.world import Transition, World
from kinfeas.training.config import TrainConfig
from kinfeas.training.worlds import training_world

StepResult = tuple[
    NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]
]


@dataclass
class Batch:
    """n episodes in one world; observations are scaled to about unit range.

    An action is repeated for `action_repeat` control periods and earns their mean reward. If an
    episode ends within them, the mean is over the periods until its end; the next one begins after
    the last period.
    """

    world: World
    size: int
    action_repeat: int = 1

    def __post_init__(self) -> None:
        """Set the scale of the observations."""
        terms = self.world.loop.observer.terms
        self.scale = observation.scale(self.world.robot, terms).astype(np.float32)
        self._saves_world = self.world.loop.backend.resumable is not None

    def start(self) -> NDArray[np.float32]:
        """Begin fresh episodes everywhere and return their observations, shape (n, d)."""
        return self._scaled(self.world.start_next(self.size))

    def step(self, actions: NDArray[np.float64]) -> StepResult:
        """Return observations, rewards, dones and infos after commands in [-1, 1], shape (n, a).

        Where done, a new episode has begun.
        """
        earned, periods = np.zeros(self.size), np.zeros(self.size)
        over = np.zeros(self.size, dtype=np.bool_)
        infos: list[dict[str, Any]] = [{} for _ in range(self.size)]
        for _ in range(self.action_repeat):
            # Rows whose episode is over are stepped along with the others, and ignored.
            transition = self.world.step(actions)
            earned += np.where(over, 0.0, transition.reward)
            periods += ~over
            self._note_ends(infos, transition, np.flatnonzero(transition.done & ~over))
            over |= transition.done
            if over.all():
                break
        ended = np.flatnonzero(over)
        if ended.size:
            self.world.start_next(ended.size, ended)
        seen = self._scaled(self.world.loop.observation.values)
        return seen, (earned / periods).astype(np.float32), over, infos

    def snapshot(self) -> dict[str, NDArray[Any]]:
        """Return the state to resume from, by name."""
        world = self.world.snapshot() if self._saves_world else {}
        return {**world, "next_episode": np.array(self.number())}

    def number(self) -> int:
        """Return the number of the next episode."""
        return self.world.next_episode

    def restore(self, snapshot: Mapping[str, NDArray[Any]]) -> NDArray[np.float32]:
        """Resume from a snapshot and return the observations, shape (n, d).

        Without a state of the world the next episodes begin.
        """
        self.world.next_episode = int(snapshot["next_episode"])
        if self._saves_world and snapshot.keys() > {"next_episode"}:
            return self._scaled(self.world.restore(snapshot))
        return self.start()

    def _note_ends(self, infos: list[dict[str, Any]], transition: Transition, rows: Rows) -> None:
        """Write the ends of the episodes in `rows` as Stable-Baselines3 reads them."""
        final = self._scaled(transition.observation[rows])
        for place, row in enumerate(rows):
            infos[row] = {
                "terminal_observation": final[place],
                "TimeLimit.truncated": bool(transition.truncated[row]),
                "is_success": bool(transition.reached[row] and self.world.failures[row] == 0),
                "failures": int(self.world.failures[row]),
            }

    def _scaled(self, seen: NDArray[np.float64]) -> NDArray[np.float32]:
        return observation.scaled(seen, self.scale)


_worker: tuple[TrainConfig, int, int] | Batch  # of a worker process


def begin_batch(config: TrainConfig, rows: int, first: int) -> None:
    """Prepare a worker process for a batch of `rows` episodes with physics, from `first` on."""
    global _worker
    begin_worker(signal.SIG_IGN)  # its parent handles Ctrl-C
    _worker = config, rows, first


def call_batch(method: str, *arguments: Any) -> Any:
    """Return the result of a method of this worker's batch, which the first call builds."""
    global _worker
    if not isinstance(_worker, Batch):
        config, rows, first = _worker
        _worker = Batch(training_world(config), rows, config.action_repeat)
        _worker.world.next_episode = first
    return methodcaller(method, *arguments)(_worker)
