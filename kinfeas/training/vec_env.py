"""The world as Stable-Baselines3 sees it."""

from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv

from kinfeas import observation
from kinfeas.envs.world import Transition, World
from kinfeas.loop import Rows

StepResult = tuple[
    NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]
]


class WorldVecEnv(VecEnv):
    """n episodes that restart by themselves; observations are scaled to about unit range.

    An action holds for a few control periods, and earns their mean. An episode that ends within
    them is over with the action; the one after it begins at once.
    """

    render_mode = None

    def __init__(self, world: World, num_envs: int, hold: int = 1) -> None:
        """Put `num_envs` episodes at a time into `world`; an action holds for `hold` periods."""
        size = (world.observation_size,)
        super().__init__(
            num_envs,
            spaces.Box(-np.inf, np.inf, size, np.float32),
            spaces.Box(-1.0, 1.0, (world.action_size,), np.float32),
        )
        self.world, self.hold = world, hold
        self.scale = observation.scale(len(world.robot.arm)).astype(np.float32)
        self.next_episode = 0
        self._worker = ThreadPoolExecutor(1)
        self._coming: Future[StepResult] | None = None

    def reset(self) -> NDArray[np.float32]:
        """Begin fresh episodes everywhere and return their observations, shape (n, d)."""
        return self._scaled(self.world.start(self._fresh(self.num_envs)))

    def step_async(self, actions: NDArray[Any]) -> None:
        """Begin a step with the actions, shape (n, a), in a thread of the world's own."""
        self._coming = self._worker.submit(self._advance, np.array(actions, dtype=np.float64))

    def step_wait(self) -> StepResult:
        """Return observations, rewards, dones and infos; where done, a new episode has begun."""
        if self._coming is None:
            raise RuntimeError("step_wait needs a step_async before it")
        coming, self._coming = self._coming, None
        return coming.result()

    def _advance(self, actions: NDArray[np.float64]) -> StepResult:
        earned = np.zeros(self.num_envs)
        over = np.zeros(self.num_envs, dtype=np.bool_)
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for _ in range(self.hold):
            transition = self.world.step(actions)
            earned += np.where(over, 0.0, transition.reward)
            self._note_ends(infos, transition, np.flatnonzero(transition.done & ~over))
            over |= transition.done
            ended = np.flatnonzero(transition.done)
            if ended.size:
                self.world.start(self._fresh(ended.size), ended)
        seen = self._scaled(self.world.loop.observation)
        return seen, (earned / self.hold).astype(np.float32), over, infos

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

    def snapshot(self) -> dict[str, NDArray[Any]]:
        """Return everything that the episodes go on from, by name; a step under way ends first."""
        if self._coming is not None:
            self._coming.result()
        return {**self.world.snapshot(), "next_episode": np.array(self.next_episode)}

    def restore(self, snapshot: Mapping[str, NDArray[Any]]) -> NDArray[np.float32]:
        """Go on from what `snapshot` returned; return the observations, shape (n, d).

        Raises:
            ValueError: If the snapshot is of another number of environments.
        """
        if len(snapshot["steps"]) != self.num_envs:
            raise ValueError(
                f"a snapshot of {len(snapshot['steps'])}, not {self.num_envs} episodes"
            )
        self.next_episode = int(snapshot["next_episode"])
        return self._scaled(self.world.restore(snapshot))

    def close(self) -> None:
        """Close the world's backend; a step under way ends first."""
        self._worker.shutdown()
        self.world.loop.backend.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return an attribute once for each of the asked-for environments."""
        return [getattr(self, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Refuse: the environments are one."""
        raise NotImplementedError("the environments of a world share their attributes")

    def env_method(
        self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any
    ) -> list[Any]:
        """Refuse: the environments are one."""
        raise NotImplementedError("the environments of a world have no methods of their own")

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:
        """Return False for each of the asked-for environments."""
        return [False for _ in self._get_indices(indices)]

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Use another seed from the next reset on."""
        if seed is not None:
            self.world.seed, self.next_episode = seed, 0
        return [seed] * self.num_envs

    def _fresh(self, count: int) -> list[int]:
        first, self.next_episode = self.next_episode, self.next_episode + count
        return list(range(first, self.next_episode))

    def _scaled(self, seen: NDArray[np.float64]) -> NDArray[np.float32]:
        return observation.scaled(seen, self.scale)
