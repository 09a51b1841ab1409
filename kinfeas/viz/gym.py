"""The world as a Gymnasium environment of one episode at a time, with pictures."""

import os
import sys
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from kinfeas.control.observation import OBSERVATION
from kinfeas.core.checks import check_array
from kinfeas.core.errors import KinfeasError
from kinfeas.envs.gym import (
    action_space,
    check_reset,
    checked_seed,
    make_world,
    observation_space,
    seed_world,
)
from kinfeas.envs.world import WorldConfig, step_info

if TYPE_CHECKING:
    from kinfeas.viz.film import FilmCamera

_SCREEN = sys.platform != "linux" or bool(os.environ.get("DISPLAY"))


class BaseMotionEnv(gymnasium.Env[NDArray[np.float32], NDArray[np.float32]]):
    """One robot whose base motion keeps the EE motion feasible.

    `reset(seed=s)` begins episode 0 of seed s; a reset without a seed begins the next episode.
    Observations are those of `kinfeas.control.observation`, unscaled. In the render mode
    `rgb_array`, PyBullet draws pictures; `human` needs the backend `pybullet` and a display.
    """

    _film: "FilmCamera | None" = None

    metadata: dict[str, Any] = {  # noqa: RUF012 - as Gymnasium declares it
        "render_modes": ["human", "rgb_array"] if _SCREEN else ["rgb_array"],
        "render_fps": 50,  # at the default control period of physics
    }

    def __init__(  # noqa: PLR0913 - Gymnasium passes each as a keyword
        self,
        robot: str = "pr2",
        task: str = "ggr",
        world: WorldConfig | Mapping[str, object] | None = None,
        task_parameters: Mapping[str, object] | None = None,
        backend: str = "analytic",
        render_mode: str | None = None,
        *,
        observation: Sequence[str] = OBSERVATION,
    ) -> None:
        """Build the world.

        Args:
            robot: Name or folder of the robot.
            task: Entry-point name or YAML file of the task.
            world: `WorldConfig`, or changes by key to the default, as of `make_world`.
            task_parameters: Keyword parameters of the task, or changes to its file.
            backend: Backend of the default settings.
            render_mode: `human` (a window of PyBullet, only with its backend), `rgb_array` or None.
            observation: Names of the observation terms, such as a policy's `observation_terms`.

        Raises:
            KinfeasError: If an argument is wrong, or the backend is not installed.
        """
        if render_mode not in (None, "human", "rgb_array"):
            raise KinfeasError(f"render_mode must be human, rgb_array or None, not {render_mode!r}")
        self.render_mode = render_mode
        self.world = make_world(
            robot, task, task_parameters, world, backend, observation, gui=render_mode == "human"
        )
        self.metadata = {**self.metadata, "render_fps": round(1.0 / self.world.config.dt)}
        self.observation_space = observation_space(self.world)
        self.action_space = action_space(self.world)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin an episode and return its observation, shape (d,), and its number.

        A seed holds for this episode and all later ones; it is random by default. `options` is not
        used.
        """
        self._end_film()
        super().reset(seed=checked_seed(seed))
        seed_world(self.world, seed, self.np_random_seed)
        info = {"episode_number": self.world.next_episode}
        return self.world.start_next(1)[0].astype(np.float32), info

    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Move the base by a command in [-1, 1], shape (3,) or (2,); return as `gymnasium.Env`."""
        check_reset(self.world)
        command = np.asarray(action, dtype=np.float64)
        check_array(command, (self.world.action_size,), "the action")
        transition = self.world.step(command[np.newaxis])
        info = {key: values[0].item() for key, values in step_info(self.world, transition).items()}
        return (
            transition.observation[0].astype(np.float32),
            float(transition.reward[0]),
            bool(transition.terminated[0]),
            bool(transition.truncated[0]),
            info,
        )

    def render(self) -> NDArray[np.uint8] | None:
        """Return a picture of robot and goal, shape (360, 480, 3), in the mode `rgb_array`."""
        check_reset(self.world)
        if self.render_mode != "rgb_array":
            return None
        from kinfeas.viz.film import FilmCamera
        from kinfeas.viz.replay import present

        replay = present(self.world)
        if self._film is None:  # the camera stays when the base moves
            self._film = FilmCamera(replay)
        return np.asarray(self._film.of(replay, 0))

    def close(self) -> None:
        """Close camera and backend."""
        self._end_film()
        self.world.close()

    def _end_film(self) -> None:
        if self._film is not None:
            self._film.close()
            self._film = None
