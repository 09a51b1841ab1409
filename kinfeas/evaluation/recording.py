"""Episodes recorded step by step, for pictures and replays."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinfeas.core import spatial
from kinfeas.core.motion import Rows
from kinfeas.core.policy import Policy
from kinfeas.core.solids import Solids
from kinfeas.core.spatial import Array
from kinfeas.envs.episodes import Watch, run_episodes
from kinfeas.envs.world import Transition, World
from kinfeas.kinematics.forward import forward
from kinfeas.scenes.scene import Scene, read_scene
from kinfeas.tasks.chain import ChainTask
from kinfeas.tasks.task import StagedTask


@dataclass(frozen=True, eq=False)
class Recording:
    """One episode of t - 1 steps: t moments with the start."""

    episode: int  # its number
    times: Array  # seconds since the start, ascending, shape (t,)
    base_pose: Array  # world pose of the base, shape (t, 7), without sensor errors
    joint_positions: Array  # arm joints, shape (t, j)
    desired: Array  # desired world pose of the EE, shape (t, 7)
    ee_pose: Array  # achieved world pose of the EE, shape (t, 7), without sensor errors
    feasible: NDArray[np.bool_]  # whether IK found the desired pose, shape (t,); True at the start
    goals: Array  # world poses of the EE at the ends of the started sub-goals, shape (sub-goals, 7)
    reached: bool  # whether the episode ended at the goal
    task_done: bool | None = None  # whether the objects met the success condition; None without one
    solids: Solids | None = None  # solids at the start, one row; None without any
    scene: Scene | None = None  # furniture at the start, unless it is among the solids

    @property
    def goal(self) -> Array:
        """World pose of the EE at the end of the last started sub-goal, shape (7,)."""
        return self.goals[-1]

    def solids_at(self, moment: int) -> Solids | None:
        """Return the solids as they stand at a moment, one row; None without any."""
        return None if self.solids is None else self.solids.at(self.times[[moment]])


def record_episodes(
    world: World, policy: Policy, episodes: int, first: int = 0, watch: Watch | None = None
) -> list[Recording]:
    """Return episodes `first` to `first + episodes - 1`; arguments as in `run_episodes`."""
    kept = {first + i: _Kept(world, first + i) for i in range(episodes)}

    def add(world: World, transition: Transition, rows: Rows, numbers: Rows) -> None:
        for row, number in zip(rows, numbers, strict=True):
            kept[number].add(world, transition, row)
        if watch is not None:
            watch(world, transition, rows, numbers)

    records = run_episodes(world, policy, episodes, watch=add, first=first)
    done = [None] * episodes if records.task_done is None else records.task_done.tolist()
    return [recorder.recording(task) for recorder, task in zip(kept.values(), done, strict=True)]


class _Kept:
    """Moments of one episode."""

    def __init__(self, world: World, episode: int) -> None:
        self.episode, self.dt = episode, world.config.dt
        start = world.task.sample(world.solver, world.rng(episode))
        ee = spatial.compose(start.base_pose, forward(world.solver.chain, start.joint_positions))
        self.moments = [(start.base_pose, start.joint_positions, ee, ee, True)]
        self.goals: dict[int, Array] = {}
        self.solids, task = start.solids, world.task
        self.scene: Scene | None = None
        if isinstance(task, StagedTask):
            scene, poses, self.solids = task.drawn(start)
            self.scene = read_scene(scene).with_poses(poses) if scene else None
        elif isinstance(task, ChainTask) and start.solids is None:
            self.scene = task.scene_with(start.target_poses)
        self.reached = False

    def add(self, world: World, transition: Transition, row: int) -> None:
        loop, (base, ee) = world.loop, world.loop.true_state
        joints = (loop.robots.true_state or loop.robots).joint_positions
        poses = (base[row], joints[row], loop.desired[row], ee[row])
        feasible = bool(transition.outcome.feasible[row])
        self.moments.append((*(pose.copy() for pose in poses), feasible))
        self.goals[int(loop.sequence.subgoal[row])] = loop.sequence.goal[row].copy()
        self.reached = bool(transition.reached[row])

    def recording(self, task_done: bool | None) -> Recording:
        base, joints, desired, ee, feasible = (np.array(x) for x in zip(*self.moments, strict=True))
        goals = np.array(list(self.goals.values()))
        times = self.dt * np.arange(len(feasible), dtype=np.float64)
        return Recording(
            self.episode, times, base, joints, desired, ee, feasible, goals, self.reached,
            task_done, self.solids, self.scene,
        )  # fmt: skip
