"""Gymnasium environments with pictures."""

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from kinfeas.envs.gym import BaseMotionEnv, check_reset

if TYPE_CHECKING:
    from kinfeas.viz.film import FilmCamera


class RenderedMotionEnv(BaseMotionEnv):
    """`BaseMotionEnv` with the render mode `rgb_array`, drawn by PyBullet.

    The render mode `human` needs the backend `pybullet`.
    """

    _film: "FilmCamera | None" = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Start an episode, as in `BaseMotionEnv`."""
        self._end_film()
        return super().reset(seed=seed, options=options)

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
        super().close()

    def _end_film(self) -> None:
        if self._film is not None:
            self._film.close()
            self._film = None
