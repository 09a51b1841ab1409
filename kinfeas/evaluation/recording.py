"""Episodes kept step by step, for pictures and replays."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinfeas.control.loop import Rows
from kinfeas.core import spatial
from kinfeas.core.policy import Policy
from kinfeas.core.spatial import Array
from kinfeas.envs.episodes import run_episodes
from kinfeas.envs.world import Transition, World
from kinfeas.kinematics.forward import forward


@dataclass(frozen=True, eq=False)
class Recording:
    """One episode of t - 1 steps: t moments, the first one its start.

    Attributes:
        episode: Its number.
        base_pose: World pose of the base, shape (t, 7).
        joint_positions: Arm joints, shape (t, j).
        desired: Desired world pose of the EE, shape (t, 7).
        ee_pose: Achieved world pose of the EE, shape (t, 7).
        feasible: Whether IK found the desired pose, shape (t,); True at the start.
        goals: World poses of the EE at the ends of the sub-goals that were begun, shape (sub-goals,
            7).
        reached: Whether the episode ended at the goal.
        dt: Seconds between moments.
    """

    episode: int
    base_pose: Array
    joint_positions: Array
    desired: Array
    ee_pose: Array
    feasible: NDArray[np.bool_]
    goals: Array
    reached: bool
    dt: float

    @property
    def goal(self) -> Array:
        """World pose of the EE at the end of the last sub-goal that was begun, shape (7,)."""
        return self.goals[-1]


def record_episodes(world: World, policy: Policy, episodes: int, first: int = 0) -> list[Recording]:
    """Return episodes `first` to `first + episodes - 1` of the world's seed, step by step."""
    kept = {first + i: _Kept(world, first + i) for i in range(episodes)}

    def watch(world: World, transition: Transition, rows: Rows, numbers: Rows) -> None:
        for row, number in zip(rows, numbers, strict=True):
            kept[number].add(world, transition, row)

    run_episodes(world, policy, episodes, watch=watch, first=first)
    return [one.recording() for one in kept.values()]


class _Kept:
    """What has been seen of one episode so far."""

    def __init__(self, world: World, episode: int) -> None:
        self.episode, self.dt = episode, world.config.dt
        start = world.task.sample(world.solver, world.rng(episode))
        ee = spatial.compose(start.base_pose, forward(world.solver.chain, start.joint_positions))
        self.moments = [(start.base_pose, start.joint_positions, ee, ee, True)]
        self.goals: dict[int, Array] = {}
        self.reached = False

    def add(self, world: World, transition: Transition, row: int) -> None:
        loop = world.loop
        self.moments.append(
            (
                loop.state.base_pose[row].copy(),
                loop.state.joint_positions[row].copy(),
                loop.desired[row].copy(),
                loop.ee_pose[row].copy(),
                bool(transition.step.feasible[row]),
            )
        )
        self.goals[int(loop.sequence.subgoal[row])] = loop.goal[row].copy()
        self.reached = bool(transition.reached[row])

    def recording(self) -> Recording:
        base, joints, desired, ee, feasible = zip(*self.moments, strict=True)
        return Recording(
            self.episode,
            np.array(base),
            np.array(joints),
            np.array(desired),
            np.array(ee),
            np.array(feasible),
            np.array(list(self.goals.values())),
            self.reached,
            self.dt,
        )
