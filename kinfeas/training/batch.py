"""Episodes side by side that restart by themselves, as a learner wants them; without torch."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinfeas.control import observation
from kinfeas.control.loop import Rows
from kinfeas.envs.world import Transition, World

StepResult = tuple[
    NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]
]


@dataclass
class Batch:
    """n episodes in one world; observations are scaled to about unit range.

    An action holds for a few control periods, and earns their mean. An episode that ends within
    them earns the mean of those until its end; the next one begins after the last period.

    Attributes:
        world: Where they happen.
        size: How many there are.
        action_repeat: Control periods of an action.
        next_episode: Number of the episode that begins next.
    """

    world: World
    size: int
    action_repeat: int = 1
    next_episode: int = 0

    def __post_init__(self) -> None:
        """Find the factors of the observations."""
        self.scale = observation.scale(self.world.robot).astype(np.float32)

    def start(self) -> NDArray[np.float32]:
        """Begin fresh episodes everywhere and return their observations, shape (n, d)."""
        return self._scaled(self.world.start(self._fresh(self.size)))

    def step(self, actions: NDArray[np.float64]) -> StepResult:
        """Return observations, rewards, dones and infos; where done, a new episode has begun.

        Args:
            actions: Base commands in [-1, 1], shape (n, a).
        """
        earned, periods = np.zeros(self.size), np.zeros(self.size)
        over = np.zeros(self.size, dtype=np.bool_)
        infos: list[dict[str, Any]] = [{} for _ in range(self.size)]
        for _ in range(self.action_repeat):
            # Rows whose episode is over are stepped along with the others, and not looked at.
            transition = self.world.step(actions)
            earned += np.where(over, 0.0, transition.reward)
            periods += ~over
            self._note_ends(infos, transition, np.flatnonzero(transition.done & ~over))
            over |= transition.done
            if over.all():
                break
        ended = np.flatnonzero(over)
        if ended.size:
            self.world.start(self._fresh(ended.size), ended)
        seen = self._scaled(self.world.loop.observation)
        return seen, (earned / periods).astype(np.float32), over, infos

    def snapshot(self) -> dict[str, NDArray[Any]]:
        """Return everything that the episodes go on from, by name."""
        return {**self.world.snapshot(), "next_episode": np.array(self.next_episode)}

    def restore(self, snapshot: Mapping[str, NDArray[Any]]) -> NDArray[np.float32]:
        """Go on from what `snapshot` returned; return the observations, shape (n, d).

        Raises:
            ValueError: If the snapshot is of another number of episodes, or counts below 0.
        """
        if len(snapshot["steps"]) != self.size:
            raise ValueError(f"a snapshot of {len(snapshot['steps'])}, not {self.size} episodes")
        self.next_episode = int(snapshot["next_episode"])
        if self.next_episode < 0:
            raise ValueError(f"a snapshot whose next episode is {self.next_episode}")
        return self._scaled(self.world.restore(snapshot))

    def _note_ends(self, infos: list[dict[str, Any]], transition: Transition, rows: Rows) -> None:
        """Write what became of the episodes in `rows`, as Stable-Baselines3 looks for it."""
        final = self._scaled(transition.observation[rows])
        for place, row in enumerate(rows):
            infos[row] = {
                "terminal_observation": final[place],
                "TimeLimit.truncated": bool(transition.truncated[row]),
                "is_success": bool(transition.reached[row] and self.world.failures[row] == 0),
                "failures": int(self.world.failures[row]),
            }

    def _fresh(self, count: int) -> list[int]:
        first, self.next_episode = self.next_episode, self.next_episode + count
        return list(range(first, self.next_episode))

    def _scaled(self, seen: NDArray[np.float64]) -> NDArray[np.float32]:
        return observation.scaled(seen, self.scale)
