"""The world as a Gymnasium vector environment: n episodes in one batch."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from kinfeas.core.errors import KinfeasError
from kinfeas.envs.batch import Batch
from kinfeas.envs.gym import (
    action_space,
    check_reset,
    checked_seed,
    learning_world,
    make_world,
    observation_space,
    seed_world,
)
from kinfeas.envs.world import WorldConfig

_Rows = NDArray[np.float32]


class BaseMotionVectorEnv(VectorEnv[_Rows, _Rows, NDArray[Any]]):
    """n robots whose base motions keep their EE motions feasible.

    An ended episode restarts in the same step; its last observation and info are in `final_obs` and
    `final_info`. `reset(seed=s)` begins episodes 0 to n - 1 of seed s; later ones take the next
    numbers in any row.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - as Gymnasium declares it
        "render_modes": [],
        "autoreset_mode": AutoresetMode.SAME_STEP,
    }

    def __init__(
        self,
        num_envs: int = 1,
        robot: str = "pr2",
        task: str = "ggr",
        world: WorldConfig | None = None,
        task_parameters: Mapping[str, object] | None = None,
        backend: str = "analytic",
    ) -> None:
        """Build the world for `num_envs` episodes; other arguments as in `BaseMotionEnv`."""
        if num_envs < 1:
            raise KinfeasError(f"num_envs must be at least 1, not {num_envs}")
        self.num_envs = num_envs
        config = world or learning_world(backend, robot)
        self.world = make_world(robot, task, task_parameters, config)
        self._batch = Batch(self.world, num_envs, infos=True)
        self.single_observation_space = observation_space(self.world)
        self.single_action_space = action_space(self.world)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[_Rows, dict[str, Any]]:
        """Begin n episodes and return their observations, shape (n, 21 + j), and numbers."""
        super().reset(seed=checked_seed(seed))
        seed_world(self.world, seed, self.np_random_seed)
        observation = self._batch.start().astype(np.float32)
        return observation, self._numbers(np.ones(self.num_envs, dtype=np.bool_))

    def step(
        self, actions: _Rows
    ) -> tuple[_Rows, NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """Move all bases by commands in [-1, 1], shape (n, 3) or (n, 2).

        Returns:
            Observations, rewards, terminated, truncated and infos.
        """
        check_reset(self.world)
        step = self._batch.step(np.asarray(actions, dtype=np.float64))
        done, truncated = np.zeros((2, self.num_envs), dtype=np.bool_)
        final = np.full(self.num_envs, None, dtype=object)
        for row, end in step.ends.items():
            done[row], truncated[row] = True, end.truncated
            final[row] = end.observation.astype(np.float32)
        infos = _masked(step.infos, ~done)
        if step.ends:
            infos |= {"final_obs": final, "_final_obs": done.copy()}
            infos |= {"final_info": _masked(step.infos, done), "_final_info": done.copy()}
            infos |= self._numbers(done)
        observation = step.observation.astype(np.float32)
        return observation, step.reward, done & ~truncated, truncated, infos

    def close_extras(self, **kwargs: Any) -> None:
        """Close the backend."""
        # Gymnasium also closes an environment whose constructor failed.
        if hasattr(self, "world"):
            self.world.close()

    def _numbers(self, rows: NDArray[np.bool_]) -> dict[str, Any]:
        numbers = self.world.next_episode - rows.sum() + np.cumsum(rows) - 1
        return _masked({"episode_number": numbers}, rows)


def _masked(infos: Mapping[str, NDArray[Any]], rows: NDArray[np.bool_]) -> dict[str, Any]:
    """Return infos in Gymnasium's layout: zeros in other rows, and masks `_key`."""
    batched: dict[str, Any] = {}
    for key, values in infos.items():
        batched[key] = np.where(rows, values, np.zeros_like(values))
        batched[f"_{key}"] = rows.copy()
    return batched
