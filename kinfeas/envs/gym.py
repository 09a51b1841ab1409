"""The world as a Gymnasium environment of n episodes in one batch."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from kinfeas.config import merged, nested, to_mapping, validated
from kinfeas.control.observation import HORIZON, OBSERVATION, TERMS, check_terms
from kinfeas.core.errors import KinfeasError
from kinfeas.envs.world import Batch, World, WorldConfig, evaluation_world
from kinfeas.robots.loading import load_robot
from kinfeas.tasks.loading import load_task

_FARTHEST = 1000.0
"""Metres; beyond any episode, since the bounds of a Gymnasium space are finite."""

_LENGTHS = ("ee_position", "goal_position", "planned_ahead", "planned_base")

_BEYOND, _NOISE = 0.1, 0.5
"""Largest distance of measured joints beyond their limits, rad or m: by motors in a physics engine,
and by adapters."""


class BaseMotionVectorEnv(VectorEnv[NDArray[np.float32], NDArray[np.float32], NDArray[Any]]):
    """n robots whose base motions keep their EE motions feasible.

    An ended episode restarts in the same step; its last observation and info are in `final_obs` and
    `final_info`. `reset(seed=s)` begins episodes 0 to n - 1 of seed s; later ones take the next
    numbers in any row.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - as Gymnasium declares it
        "render_modes": [],
        "autoreset_mode": AutoresetMode.SAME_STEP,
    }

    def __init__(  # noqa: PLR0913 - as in `BaseMotionEnv`
        self,
        num_envs: int = 1,
        robot: str = "pr2",
        task: str = "ggr",
        world: WorldConfig | Mapping[str, object] | None = None,
        task_parameters: Mapping[str, object] | None = None,
        backend: str = "analytic",
        *,
        render_mode: None = None,
        observation: Sequence[str] = OBSERVATION,
    ) -> None:
        """Build the world for `num_envs` episodes; other arguments as in `BaseMotionEnv`.

        There are no pictures: `render_mode` must be None.
        """
        if num_envs < 1:
            raise KinfeasError(f"num_envs must be at least 1, not {num_envs}")
        if render_mode is not None:
            raise KinfeasError(f"render_mode must be None side by side, not {render_mode!r}")
        self.num_envs = num_envs
        self.world = make_world(robot, task, task_parameters, world, backend, observation)
        self._batch = Batch(self.world, num_envs, infos=True)
        self.single_observation_space = observation_space(self.world)
        self.single_action_space = action_space(self.world)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin n episodes; return their observations, shape (n, d), and infos with numbers."""
        super().reset(seed=checked_seed(seed))
        seed_world(self.world, seed, self.np_random_seed)
        observation = self._batch.start().astype(np.float32)
        return observation, self._numbers(np.ones(self.num_envs, dtype=np.bool_))

    def step(
        self, actions: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """Move all bases by commands in [-1, 1], shape (n, 3) or (n, 2); return as `VectorEnv`."""
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


def make_world(  # noqa: PLR0913 - as in `BaseMotionEnv`
    robot: str,
    task: str,
    task_parameters: Mapping[str, object] | None,
    world: WorldConfig | Mapping[str, object] | None,
    backend: str,
    observation: Sequence[str],
    *,
    gui: bool = False,
) -> World:
    """Return the world of an environment, with seed 0.

    The analytic world has the defaults of `WorldConfig`, others have the settings of the robot's
    evaluations, but without command filters, so that rewards belong to the commanded actions. A
    mapping changes these settings. Arguments as in `BaseMotionEnv`; `gui` opens a window.
    """
    terms = check_terms(observation, "observation")
    if isinstance(world, WorldConfig):
        config = world
    elif world is None or isinstance(world, Mapping):
        default = WorldConfig()
        if backend != "analytic":
            default = replace(evaluation_world(backend, robot), filters=())
        changes = merged(to_mapping(default), nested(world))
        config = validated(WorldConfig, changes, "arguments", "world")
    else:
        raise KinfeasError(f"world must be a WorldConfig or a mapping, not {world!r}")
    if gui:
        if config.backend != "pybullet":
            raise KinfeasError(f"render_mode 'human' needs PyBullet, not {config.backend!r}")
        config = replace(config, backend_parameters={**config.backend_parameters, "gui": True})
    made = World(load_robot(robot), load_task(task, task_parameters), config, seed=0)
    made.loop.observer.terms = terms
    return made


def observation_space(world: World) -> "spaces.Box[np.float32]":
    """Return the space of the observation of one robot, shape (d,), metres and radians."""
    # Joints may go beyond one turn, although they do not begin there.
    limits, continuous = world.robot.joint_limits, world.robot.continuous
    beyond = 0.0 if world.config.backend == "analytic" else _BEYOND
    beyond += _NOISE if world.config.adapters else 0.0
    joints = np.where(continuous, [[-np.pi], [np.pi]], limits) + np.array([[-beyond], [beyond]])
    bounds = dict.fromkeys(_LENGTHS, _FARTHEST) | {"planned_velocity": _FARTHEST / HORIZON}
    low, high = np.hstack([
        joints
        if name == "joint_positions"
        else np.outer([-1.0, 1.0], np.full(TERMS[name].width(world.robot), bounds.get(name, 1.0)))
        for name in world.loop.observer.terms
    ])  # fmt: skip
    return spaces.Box(low.astype(np.float32), high.astype(np.float32))


def action_space(world: World) -> "spaces.Box[np.float32]":
    """Return the space of base commands, shape (3,) or (2,), as fractions of the limits."""
    return spaces.Box(-1.0, 1.0, (world.action_size,), np.float32)


def checked_seed(seed: object) -> int | None:
    """Return a seed as a Python int, which Gymnasium asks for."""
    if not isinstance(seed, int | np.integer | None) or (seed is not None and seed < 0):
        raise KinfeasError(f"seed must be a number from 0, not {seed!r}")
    return None if seed is None else int(seed)


def seed_world(world: World, seed: int | None, np_random_seed: int | None) -> None:
    """Set the seed of a world to Gymnasium's; a new `seed` begins with episode 0."""
    if np_random_seed is None or np_random_seed < 0:
        raise KinfeasError("set the seed by reset(seed=...): np_random, which was set, has none")
    world.seed = np_random_seed
    if seed is not None:
        world.next_episode = 0


def check_reset(world: World) -> None:
    """Raise ResetNeeded before the first episode."""
    if not world.next_episode:
        raise ResetNeeded("call reset first")
