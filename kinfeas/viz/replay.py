"""Recorded episodes, and everything visible in them, for pictures, films and pages."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from kinfeas.backends.physics.backend import LinkName, PhysicsBackend
from kinfeas.core import spatial
from kinfeas.core.errors import KinfeasError
from kinfeas.core.motion import Rows
from kinfeas.core.policy import Policy
from kinfeas.core.solids import Solids
from kinfeas.core.spatial import IDENTITY, Array, compose
from kinfeas.envs.episodes import Watch, run_episodes
from kinfeas.envs.world import Transition, World
from kinfeas.io.run_log import REACHED, TASK_DONE, Record
from kinfeas.kinematics.forward import build_chain, forward
from kinfeas.robots.robot import Robot
from kinfeas.scenes.scene import Scene, read_scene
from kinfeas.tasks.chain import ChainTask
from kinfeas.tasks.task import StagedTask
from kinfeas.viz.shapes import (
    VisualShape,
    robot_poses,
    robot_shapes,
    scene_poses,
    scene_shapes,
    solid_shapes,
    surrounding,
    visual_shapes,
)
from kinfeas.viz.style import TITLES, failures_text

_WALL = 4.0  # m; longer boxes are not drawn, since they hide the room
_TURN = np.deg2rad(12.0)  # rotation of a side view, which brings the arm to the front


@dataclass(frozen=True, eq=False)
class Recording:
    """One episode of t - 1 steps: t moments with the start."""

    episode: int  # its number
    times: Array  # seconds since the start, ascending, shape (t,)
    base_pose: Array  # world pose of the base, shape (t, 7), without sensor errors
    joint_positions: Array  # arm joints, shape (t, j)
    desired: Array  # desired world pose of the EE, shape (t, 7)
    ee_pose: Array  # achieved world pose of the EE, shape (t, 7), without sensor errors
    feasible: NDArray[np.bool_]  # whether IK solved for the desired pose, (t,); True at the start
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
    recorders = {first + i: _Recorder(world, first + i) for i in range(episodes)}

    def add(world: World, transition: Transition, rows: Rows, numbers: Rows) -> None:
        for row, number in zip(rows, numbers, strict=True):
            recorders[number].add(world, transition, row)
        if watch is not None:
            watch(world, transition, rows, numbers)

    records = run_episodes(world, policy, episodes, watch=add, first=first)
    done = [None] * episodes if records.task_done is None else records.task_done.tolist()
    pairs = zip(recorders.values(), done, strict=True)
    return [recorder.recording(task) for recorder, task in pairs]


class _Recorder:
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


@dataclass(frozen=True, eq=False)
class EpisodeReplay:
    """A recorded episode and what is visible in it."""

    recording: Recording  # the episode
    title: str  # robot and task
    shapes: Sequence[VisualShape]  # visible shapes in the frames of their links
    links: Callable[[int], Mapping[LinkName, Array]]  # returns the links' world poses at a moment


def replay_of(recording: Recording, robot: Robot, title: str) -> EpisodeReplay:
    """Return a recorded episode with the robot's primitive shapes and the furniture."""
    shapes = list(robot_shapes(robot))
    furniture: dict[LinkName, Array] = {}
    if (scene := recording.scene) is not None:
        around, furniture = surrounding(scene), scene_poses(scene)
        shapes += [visual for visual in scene_shapes(scene) if visual.link[0] not in around]

    def links(moment: int) -> Mapping[LinkName, Array]:
        base, joints = recording.base_pose[moment], recording.joint_positions[moment]
        return {**furniture, **robot_poses(robot, base, joints)}

    return _with_solids(EpisodeReplay(recording, title, shapes, links))


def run_episode(world: World, policy: Policy, episode: int) -> EpisodeReplay:
    """Run one episode of a world and return it with everything visible."""
    backend = world.backend
    title = f"{TITLES.get(world.robot.name, world.robot.name)}, {world.task.name}"
    if not isinstance(backend, PhysicsBackend):
        (recording,) = record_episodes(world, policy, 1, episode)
        return replay_of(recording, world.robot, title)
    world.task.sample(world.solver, world.rng(episode))
    shapes, names = _visible(backend)
    moments = [backend.link_poses(0, names)]

    def watch(*_: object) -> None:
        moments.append(backend.link_poses(0, names))

    (recording,) = record_episodes(world, policy, 1, episode, watch)

    def links(moment: int) -> Mapping[LinkName, Array]:
        return dict(zip(names, moments[moment], strict=True))

    return _with_solids(EpisodeReplay(recording, title, shapes, links))


def as_recording(record: Record, robot: Robot) -> Recording:
    """Return a recorded run as an episode, with achieved EE poses from measured joints."""
    joints = tuple(joint.name for joint in robot.arm)
    if record.about.joints != joints:
        raise KinfeasError(
            f"the record has the joints {', '.join(record.about.joints)}, and the arm of robot "
            f"{robot.name!r} {', '.join(joints)}"
        )
    valid = np.isfinite(record.base_pose[:, 0])  # the last measurement may be invalid
    base, arm = record.base_pose[valid], record.joint_positions[valid]
    ee = forward(build_chain(robot), arm)
    around = record.about.solids
    solids = Solids.from_table(np.array(around)) if around else None
    last = [np.flatnonzero(record.subgoal == subgoal)[-1] for subgoal in np.unique(record.subgoal)]
    return Recording(
        0, record.time[valid], base, arm, record.desired[valid], compose(base, ee),
        record.feasible[valid], record.goal[last],
        reached=record.event[-1].startswith(REACHED), solids=solids, scene=_scene_of(record),
    )  # fmt: skip


def _scene_of(record: Record) -> Scene | None:
    """Return the furniture at the start of a run; None without a scene."""
    if not record.about.scene:
        return None
    poses = {name: np.array(pose) for name, pose in record.about.objects.items()}
    return read_scene(record.about.scene).with_poses(poses)


def present(world: World) -> EpisodeReplay:
    """Return the present state of a world's first robot, as an episode of one moment."""
    loop, backend = world.loop, world.backend
    state = loop.robots
    now = Recording(
        0, np.zeros(1), state.base_pose[:1], state.joint_positions[:1], loop.desired[:1],
        loop.ee_pose[:1], np.array([True]), loop.sequence.goal[:1], reached=False,
    )  # fmt: skip
    if isinstance(backend, PhysicsBackend):
        solids = backend.solid_bodies()
    else:
        solids = None if backend.solids is None else backend.solids.after()
    now = replace(now, solids=None if solids is None else solids.of(np.array([0])))
    if not isinstance(backend, PhysicsBackend):
        return replay_of(now, world.robot, "")
    shapes, names = _visible(backend)
    links = dict(zip(names, backend.link_poses(0, names), strict=True))
    return _with_solids(EpisodeReplay(now, "", shapes, lambda _: links))


def shown_moments(times: Array, count: int) -> list[int]:
    """Return indices of up to `count` times, evenly spaced, with the first and the last."""
    evenly = np.linspace(times[0], times[-1], max(2, count))
    return np.unique(np.searchsorted(times, evenly)).tolist()


def side_heading(recording: Recording) -> float:
    """Return the world heading to the right of a side view in which the arm is in front."""
    travel = recording.goal[:2] - recording.base_pose[0, :2]
    heading = float(np.arctan2(travel[1], travel[0]))
    arm = (recording.ee_pose[:, :2] - recording.base_pose[:, :2]).mean(axis=0)
    headings = (heading + _TURN, heading + np.pi - _TURN)
    return max(headings, key=lambda angle: float(arm @ [np.sin(angle), -np.cos(angle)]))


def result(recording: Recording) -> tuple[str, bool]:
    """Return the result of an episode as a text, and whether it is a success."""
    text = "goal reached" if recording.reached else "goal not reached"
    succeeded = recording.reached and recording.task_done is not False
    return text + TASK_DONE[recording.task_done], succeeded


def caption(recording: Recording) -> str:
    """Return result, IK failures and duration of an episode as a text."""
    failures = failures_text(int(np.sum(~recording.feasible)))
    return f"{result(recording)[0]}, {failures}, {recording.times[-1]:.0f} s"


def _visible(backend: PhysicsBackend) -> tuple[list[VisualShape], list[LinkName]]:
    shapes = visual_shapes(backend.robot)
    if backend.scene is not None:
        shapes += scene_shapes(backend.scene)
    shapes = [s for s in shapes if s.shape.kind != "box" or max(s.shape.size) <= _WALL]
    return shapes, list(dict.fromkeys(visual.link for visual in shapes))


def _with_solids(episode: EpisodeReplay) -> EpisodeReplay:
    solids = solid_shapes(episode.recording.solids)
    if not solids:
        return episode
    shapes = [
        VisualShape(link, replace(shape, pose=IDENTITY), colour) for link, shape, colour in solids
    ]

    def links(moment: int) -> Mapping[LinkName, Array]:
        moved = solid_shapes(episode.recording.solids_at(moment))
        return {**episode.links(moment), **{solid.link: solid.shape.pose for solid in moved}}

    return replace(episode, shapes=[*episode.shapes, *shapes], links=links)
