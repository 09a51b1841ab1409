"""The world as a Gymnasium environment of one episode at a time."""

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from kinfeas.envs.interface import (
    action_space,
    check_reset,
    make_world,
    observation_space,
    read_actions,
    read_seed,
    step_info,
    world_seed,
)
from kinfeas.envs.world import World, WorldConfig


class BaseMotionEnv(gymnasium.Env[NDArray[np.float32], NDArray[np.float32]]):
    """One robot whose base is to keep the EE's motion feasible.

    `reset(seed=s)` begins episode 0 of seed s, each reset without a seed the episode after it.
    Observations are as `kinfeas.control.observation` describes them, not scaled.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012 - as Gymnasium declares it

    def __init__(
        self,
        robot: str = "pr2",
        task: str = "ggr",
        world: WorldConfig | None = None,
        task_parameters: Mapping[str, object] | None = None,
    ) -> None:
        """Build the world; arguments as in `make_world`."""
        self._enter(make_world(robot, task, task_parameters, world))

    def _enter(self, world: World, beyond: float = 0.0) -> None:
        """Take a world, and its spaces; `beyond` is as in `observation_space`."""
        self.world = world
        self.observation_space = observation_space(self.world, beyond)
        self.action_space = action_space(self.world)
        self.next_episode = 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin an episode and return its observation, shape (21 + j,), and its number.

        Args:
            seed: Of this episode and all later ones; a random one if there never was any.
            options: Not used.

        Raises:
            KinfeasError: If the seed is not one whole number, or `np_random` was set.
        """
        super().reset(seed=read_seed(seed))
        if seed is not None:
            self.next_episode = 0
        self.world.seed = world_seed(self.np_random_seed)
        episode, self.next_episode = self.next_episode, self.next_episode + 1
        seen = self.world.start([episode])
        return seen[0].astype(np.float32), {"episode_number": episode}

    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Move the base and return observation, reward, terminated, truncated and info.

        Args:
            action: Base command in [-1, 1], shape (3,) or (2,).

        Raises:
            KinfeasError: If the action is of another shape or not finite.
            ResetNeeded: If no episode was begun.
        """
        check_reset(self.next_episode)
        command = read_actions(action, (self.world.action_size,))
        transition = self.world.step(command[np.newaxis])
        info = {key: values[0].item() for key, values in step_info(self.world, transition).items()}
        return (
            transition.observation[0].astype(np.float32),
            float(transition.reward[0]),
            bool(transition.terminated[0]),
            bool(transition.truncated[0]),
            info,
        )

    def close(self) -> None:
        """Close the world's backend."""
        self.world.loop.backend.close()
