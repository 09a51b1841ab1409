"""The PyBullet world as a Gymnasium environment, at the control rate of a robot."""

import os
import sys
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinfeas.backends.pybullet.camera import take_picture
from kinfeas.backends.pybullet.contacts import Contacts
from kinfeas.core.errors import KinfeasError
from kinfeas.envs.gym import BaseMotionEnv
from kinfeas.envs.interface import check_reset
from kinfeas.envs.physics import PhysicsSettings, make_physics_world, make_stage, physics_config
from kinfeas.envs.reward import RewardConfig
from kinfeas.robots.loading import load_robot
from kinfeas.tasks.loading import load_task

_BEYOND = 0.1
"""How far motors let joints be beyond their limits at most, rad or m."""

_SIZE = (480, 360)
_CHEST = 0.7  # m above the floor, the middle of a robot
_BESIDE, _UP, _NEAREST = 0.6, 0.55, 2.4  # of the distance to the goal; m


def _screen() -> bool:
    """Return whether there is a screen to open a window on."""
    return sys.platform != "linux" or bool(os.environ.get("DISPLAY"))


class PhysicsMotionEnv(BaseMotionEnv):
    """One robot in the PyBullet world, whose base is to keep the EE's motion feasible.

    Seeds and episodes are as in `BaseMotionEnv`; a step is a control period, 0.02 s by default.
    Infos also tell how many things base and arm touch. The render mode `rgb_array` needs no screen,
    `human` does, and is there only where one is.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - as Gymnasium declares it
        "render_modes": ["human", "rgb_array"] if _screen() else ["rgb_array"],
        "render_fps": 50,  # with the control period that it has by default
    }

    def __init__(
        self,
        robot: str = "pr2",
        task: str = "ggr",
        world: PhysicsSettings | None = None,
        task_parameters: Mapping[str, object] | None = None,
        reward: RewardConfig | None = None,
        render_mode: str | None = None,
    ) -> None:
        """Build the world.

        Args:
            robot: Name or YAML file of the robot.
            task: Entry-point name or YAML file of the task.
            world: Where it happens; by default what suits the robot, but for a base that yields or
                keeps clear: what is learned from are the commands that were given.
            task_parameters: Keyword parameters of the task, or changes to its file.
            reward: What a step earns; as in training by default.
            render_mode: `human`, `rgb_array` or None.

        Raises:
            KinfeasError: If robot, task, world, reward or render mode are wrong, PyBullet is not
                installed, or there is no screen for a window.
        """
        if render_mode not in (None, "human", "rgb_array"):
            raise KinfeasError(f"render_mode must be human, rgb_array or None, not {render_mode!r}")
        if not isinstance(world, PhysicsSettings | None):
            raise KinfeasError(f"world must be PhysicsSettings or None, not {world!r}")
        if not isinstance(reward, RewardConfig | None):
            raise KinfeasError(f"reward must be RewardConfig or None, not {reward!r}")
        self.render_mode = render_mode
        known = load_robot(robot)
        settings = world or replace(physics_config(known).world, filters=())
        self.stage = make_stage(
            known, load_task(task, task_parameters), settings, gui=render_mode == "human"
        )
        config = replace(settings.world, reward=reward or RewardConfig())
        self.metadata = {**self.metadata, "render_fps": round(1.0 / settings.dt)}
        made = make_physics_world(known, self.stage, config, settings.execution, 0)
        self._enter(made, _BEYOND)

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
        seen, earned, terminated, truncated, info = super().step(action)
        touched: Contacts = self.stage.backend.sims[0].contacts()
        info |= {"base_contacts": touched.base, "arm_contacts": touched.arm}
        return seen, earned, terminated, truncated, info

    def render(self) -> NDArray[np.uint8] | None:
        """Return a picture of robot and goal, shape (360, 480, 3), if `rgb_array` was asked for.

        Raises:
            ResetNeeded: If no episode was begun.
        """
        check_reset(self.next_episode)
        if self.render_mode != "rgb_array":
            return None
        loop = self.world.loop
        base, goal = loop.state.base_pose[0, :3] + [0.0, 0.0, _CHEST], loop.goal[0, :3]
        way = (goal - base) * [1.0, 1.0, 0.0]
        apart = max(float(np.linalg.norm(way)), 1e-3)
        across = np.array([way[1], -way[0], 0.0]) / apart
        away = max(apart + 0.8, _NEAREST)
        # From beside the way, a bit behind the robot.
        eye = (base + goal) / 2.0 + away * (across - _BESIDE * way / apart)
        eye[2] += _UP * away
        return take_picture(
            self.stage.backend.sims[0].physics, eye, (base + goal) / 2.0, _SIZE
        ).colour
