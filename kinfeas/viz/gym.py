"""The analytic world as a Gymnasium environment that can be looked at."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from kinfeas.core.errors import KinfeasError
from kinfeas.envs.gym import BaseMotionEnv
from kinfeas.envs.interface import check_reset
from kinfeas.envs.world import WorldConfig

if TYPE_CHECKING:
    from kinfeas.viz.pictures.moment import Camera


class RenderedMotionEnv(BaseMotionEnv):
    """`BaseMotionEnv` with the render mode `rgb_array`, which matplotlib draws."""

    metadata: dict[str, Any] = {  # noqa: RUF012 - as Gymnasium declares it
        "render_modes": ["rgb_array"],
        "render_fps": 10,  # with the control period that it has by default
    }

    def __init__(
        self,
        robot: str = "pr2",
        task: str = "ggr",
        world: WorldConfig | None = None,
        task_parameters: Mapping[str, object] | None = None,
        render_mode: str | None = None,
    ) -> None:
        """Build the world; arguments as in `make_world`, `render_mode` is `rgb_array` or None.

        Raises:
            KinfeasError: If one of them is wrong.
        """
        if render_mode not in (None, "rgb_array"):
            raise KinfeasError(f"render_mode must be rgb_array or None, not {render_mode!r}")
        super().__init__(robot, task, world, task_parameters)
        self.render_mode = render_mode
        self.metadata = {**self.metadata, "render_fps": round(1.0 / self.world.config.dt)}
        self._camera: Camera | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin an episode, as in `BaseMotionEnv`."""
        self._camera = None
        return super().reset(seed=seed, options=options)

    def render(self) -> NDArray[np.uint8] | None:
        """Return a picture of robot and goal, shape (360, 480, 3), if `rgb_array` was asked for.

        Raises:
            ResetNeeded: If no episode was begun.
        """
        check_reset(self.next_episode)
        if self.render_mode is None:
            return None
        from kinfeas.viz.pictures.moment import moment_image, watch

        loop = self.world.loop
        base, ee, desired = (x[:1, :3] for x in (loop.state.base_pose, loop.ee_pose, loop.desired))
        goal = loop.goal[:1, :3]
        if self._camera is None:  # it stays where it is, as the base moves
            self._camera = watch(base[0], goal[0], np.concatenate([ee, goal]))
        posture = loop.state.base_pose[0], loop.state.joint_positions[0]
        robot = self.world.solver.robot
        return moment_image(robot, posture, (base, ee, desired), goal, self._camera)
