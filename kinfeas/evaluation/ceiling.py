"""The ceiling of a task: what no policy can beat."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from kinfeas.envs.world import GOAL_METRES, GOAL_RADIANS
from kinfeas.kinematics.ceiling import Ceiling, reachable
from kinfeas.kinematics.ik import IkOptions, IkSolver
from kinfeas.robots.robot import Robot
from kinfeas.spatial import Array
from kinfeas.tasks.task import Task


@dataclass(frozen=True)
class CeilingConfig:
    """What can be set of a ceiling beside robot, task and seed.

    Attributes:
        task: Keyword parameters of the task.
        ik: How hard IK searches, and whether the robot may touch itself.
    """

    task: dict[str, object] = field(default_factory=dict)
    ik: IkOptions = field(default_factory=IkOptions)


def measure_ceiling(
    robot: Robot,
    task: Task,
    episodes: int,
    seed: int,
    ik: IkOptions | None = None,
    on_done: Callable[[float], None] | None = None,
) -> Ceiling:
    """Return which goals of episodes 0 to `episodes` - 1 some base pose can reach.

    A robot with leeway has to come as near to the goal as success asks for; all others have to
    reach it exactly, free of self-collision like every solution.

    Args:
        robot: Who moves.
        task: Draws the goals, the same ones as in an evaluation.
        episodes: How many goals, at least 1.
        seed: Of the episodes.
        ik: How hard IK searches, and whether the robot may touch itself.
        on_done: Called with the share of all work, 0-1, that has just been done.
    """
    solver = IkSolver(robot, _options(robot, ik or IkOptions()))
    return reachable(solver, draw_goals(solver, task, episodes, seed), on_done=on_done)


def draw_goals(solver: IkSolver, task: Task, episodes: int, seed: int) -> Array:
    """Return the goals of episodes 0 to `episodes` - 1 as world poses, shape (episodes, 7)."""
    rngs = (np.random.default_rng((seed, episode)) for episode in range(episodes))
    return np.stack([task.sample(solver, rng).target_pose for rng in rngs])


def _options(robot: Robot, ik: IkOptions) -> IkOptions:
    if robot.leeway is None or not ik.leeway:
        return ik
    return replace(
        ik, leeway=False, position_tolerance=GOAL_METRES, rotation_tolerance=float(GOAL_RADIANS)
    )
