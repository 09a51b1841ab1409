"""What both Gymnasium environments have in common: spaces, actions and infos of a world."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from numpy.typing import ArrayLike, NDArray

from kinfeas.control.observation import HORIZON, OBSERVATION, TERMS
from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import Array
from kinfeas.envs.world import Transition, World, WorldConfig
from kinfeas.robots.loading import load_robot
from kinfeas.tasks.loading import load_task

_FARTHEST = 1000.0
"""Metres; wider than any episode, since Gymnasium wants the bounds of a space to be finite."""

_NOISE = 0.5
"""How far from where it is adapters may let a joint be measured, rad or m; more than they do."""


def make_world(
    robot: str,
    task: str,
    task_parameters: Mapping[str, object] | None = None,
    config: WorldConfig | None = None,
) -> World:
    """Return a world of seed 0.

    Args:
        robot: Name or YAML file of the robot.
        task: Entry-point name or YAML file of the task.
        task_parameters: Its keyword parameters, or changes to the file; none by default.
        config: Everything else; the defaults of `WorldConfig` by default.

    Raises:
        KinfeasError: If there is no such robot or task, or a parameter is wrong.
    """
    return World(
        load_robot(robot),
        load_task(task, task_parameters),
        config or WorldConfig(),
        seed=0,
    )


def observation_space(world: World, beyond: float = 0.0) -> "spaces.Box[np.float32]":
    """Return the space of what is seen of one robot, shape (21 + j,), in metres and radians.

    Args:
        world: Where it is seen; within adapters its joints may be measured elsewhere.
        beyond: How far its joints may really be beyond their limits, rad or m.
    """
    bounds = {
        "ee_position": _FARTHEST,
        "planned_velocity": _FARTHEST / HORIZON,
        "goal_position": _FARTHEST,
    }
    poses = [name for name in OBSERVATION if name != "joint_positions"]
    fields = np.concatenate([np.full(TERMS[name].size, bounds.get(name, 1.0)) for name in poses])
    low, high = world.robot.finite_joint_limits
    beyond += _NOISE if world.config.adapters else 0.0
    return spaces.Box(
        np.concatenate([-fields, low - beyond]).astype(np.float32),
        np.concatenate([fields, high + beyond]).astype(np.float32),
    )


def action_space(world: World) -> "spaces.Box[np.float32]":
    """Return the space of one robot's base commands, shape (3,) or (2,), shares of the limits."""
    return spaces.Box(-1.0, 1.0, (world.action_size,), np.float32)


def read_seed(seed: int | None) -> int | None:
    """Return a seed as Gymnasium takes it, which allows no number of NumPy's.

    Raises:
        KinfeasError: If it is not one whole number.
    """
    if not isinstance(seed, int | np.integer | None):
        raise KinfeasError(f"seed must be one number for all episodes, not {seed!r}")
    return None if seed is None else int(seed)


def world_seed(np_random_seed: int | None) -> int:
    """Return the seed of a world from what Gymnasium knows of it.

    Raises:
        KinfeasError: If it knows none, since a source of randomness was set in its place.
    """
    if np_random_seed is None or np_random_seed < 0:
        raise KinfeasError("set the seed by reset(seed=...): np_random, which was set, has none")
    return np_random_seed


def read_actions(actions: ArrayLike, shape: tuple[int, ...]) -> Array:
    """Return base commands as the world takes them.

    Raises:
        KinfeasError: If they are not numbers of that shape, or not finite.
    """
    read = np.asarray(actions, dtype=np.float64)
    allowed = f"an action must be finite numbers of shape {shape}"
    if read.shape != shape:
        raise KinfeasError(f"{allowed}, not of shape {read.shape}")
    if not np.isfinite(read).all():
        raise KinfeasError(f"{allowed}, not NaN or infinite")
    return read


def check_reset(next_episode: int) -> None:
    """Do nothing if an episode was begun.

    Raises:
        ResetNeeded: If not; as what `gymnasium.make` wraps around an environment does.
    """
    if not next_episode:
        raise ResetNeeded("call reset first")


def step_info(world: World, transition: Transition) -> dict[str, NDArray[Any]]:
    """Return what else a step of n episodes brought, by name, each of shape (n,).

    `failures` counts from the episode's beginning; `is_success` is a goal reached without any.
    """
    step, failures = transition.step, world.failures.copy()
    return {
        "subgoal": step.subgoal,
        "feasible": step.feasible,
        "failures": failures,
        "deviation": step.deviation,
        "goal_distance": step.goal_distance,
        "goal_angle": step.goal_angle,
        "joint_jump": step.joint_jump,
        "reached": transition.reached,
        "is_success": transition.reached & (failures == 0),
    }
