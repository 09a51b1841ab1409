"""Gymnasium environments with pictures."""

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from kinfeas.backends.physics.backend import PhysicsBackend
from kinfeas.envs.gym import BaseMotionEnv, check_reset

if TYPE_CHECKING:
    from kinfeas.viz.episodes import Camera


class RenderedMotionEnv(BaseMotionEnv):
    """`BaseMotionEnv` with the render mode `rgb_array`, drawn by matplotlib."""

    metadata: dict[str, Any] = {  # noqa: RUF012 - as Gymnasium declares it
        "render_modes": ["rgb_array"],
        "render_fps": 10,  # with the control period that it has by default
    }

    _camera: "Camera | None" = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Start an episode, as in `BaseMotionEnv`."""
        self._camera = None
        return super().reset(seed=seed, options=options)

    def render(self) -> NDArray[np.uint8] | None:
        """Return a picture of robot and goal, shape (360, 480, 3), in the mode `rgb_array`."""
        check_reset(self.world)
        if self.render_mode != "rgb_array":
            return None
        from kinfeas.evaluation.recording import Recording
        from kinfeas.viz.episodes import moment_image, robot_at, watch
        from kinfeas.viz.physics_film import solids, visible

        loop = self.world.loop
        state, backend = loop.robots, self.world.backend
        present = None if backend.solids is None else backend.solids.after()
        if isinstance(backend, PhysicsBackend):  # furniture is visible already
            present = backend.solid_bodies()
        around = present.of(np.array([0])) if present else None
        now = Recording(
            0, state.base_pose[:1], state.joint_positions[:1], loop.desired[:1], loop.ee_pose[:1],
            np.array([True]), loop.sequence.goal[:1], reached=False, dt=loop.dt, solids=around,
        )  # fmt: skip
        if self._camera is None:  # it stays when the base moves
            self._camera = watch(now)
        if isinstance(backend, PhysicsBackend):
            shapes, links = visible(backend)
            seen = solids(shapes, links, backend.link_poses(0, links))
        else:
            seen = robot_at(self.world.robot, now, 0)
        return moment_image(seen, now, self._camera, 0)


class WindowedMotionEnv(RenderedMotionEnv):
    """`RenderedMotionEnv` in PyBullet, which also has the render mode `human`."""

    metadata = BaseMotionEnv.metadata
