"""Episodes with everything visible at each moment, for films and pages."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from kinfeas.backends.physics.backend import LinkName, PhysicsBackend
from kinfeas.core.errors import KinfeasError
from kinfeas.core.policy import Policy
from kinfeas.core.solids import Solids
from kinfeas.core.spatial import IDENTITY, Array, compose
from kinfeas.envs.world import World
from kinfeas.evaluation.paper import TITLES
from kinfeas.evaluation.recording import Recording, record_episodes
from kinfeas.io.run_log import REACHED, TASK_DONE, Record
from kinfeas.kinematics.forward import build_chain, forward
from kinfeas.robots.robot import Robot
from kinfeas.scenes.scene import Scene, read_scene
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

_WALL = 4.0  # m; longer boxes hide the room


@dataclass(frozen=True, eq=False)
class EpisodeReplay:
    """A recorded episode and what is visible in it."""

    recording: Recording  # the episode
    title: str  # robot and task
    shapes: Sequence[VisualShape]  # visible shapes in the frames of their links
    links: Callable[[int], Mapping[LinkName, Array]]  # returns their world poses at a moment


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
    shapes: list[VisualShape] = []
    names: list[LinkName] = []
    moments: list[Array] = []

    def watch(*_: object) -> None:
        if isinstance(backend, PhysicsBackend):
            moments.append(backend.link_poses(0, names))

    if isinstance(backend, PhysicsBackend):
        world.task.sample(world.solver, world.rng(episode))
        shapes, names = _visible(backend)
        watch()
    (recording,) = record_episodes(world, policy, 1, episode, watch)
    if not isinstance(backend, PhysicsBackend):
        return replay_of(recording, world.robot, title)

    def links(moment: int) -> Mapping[LinkName, Array]:
        return dict(zip(names, moments[moment], strict=True))

    return _with_solids(EpisodeReplay(recording, title, shapes, links))


def as_recording(record: Record, robot: Robot) -> Recording:
    """Return a recorded run as an episode; the achieved EE pose is that of the measured joints."""
    joints = tuple(joint.name for joint in robot.arm)
    if record.about.joints != joints:
        raise KinfeasError(
            f"the record has the joints {', '.join(record.about.joints)}, and the arm of robot "
            f"{robot.name!r} {', '.join(joints)}"
        )
    ee = forward(build_chain(robot), record.joint_positions)
    around = record.about.solids
    solids = Solids.from_table(np.array(around)) if around else None
    last = [np.flatnonzero(record.subgoal == subgoal)[-1] for subgoal in np.unique(record.subgoal)]
    return Recording(
        0, record.time, record.base_pose, record.joint_positions, record.desired,
        compose(record.base_pose, ee), record.feasible, record.goal[last],
        reached=record.event[-1].startswith(REACHED), solids=solids, scene=_scene_of(record),
    )  # fmt: skip


def _scene_of(record: Record) -> Scene | None:
    """Return the furniture at the start of a run; None without a scene."""
    if not record.about.scene:
        return None
    poses = {name: np.array(pose) for name, pose in record.about.objects.items()}
    return read_scene(record.about.scene).with_poses(poses)


def present(world: World) -> EpisodeReplay:
    """Return the present moment of the first robot of a world."""
    loop, backend = world.loop, world.backend
    state = loop.robots
    now = Recording(
        0, np.zeros(1), state.base_pose[:1], state.joint_positions[:1], loop.desired[:1],
        loop.ee_pose[:1], np.array([True]), loop.sequence.goal[:1], reached=False,
    )  # fmt: skip
    if not isinstance(backend, PhysicsBackend):
        solids = None if backend.solids is None else backend.solids.after()
        now = replace(now, solids=None if solids is None else solids.of(np.array([0])))
        return replay_of(now, world.robot, "")
    shapes, names = _visible(backend)
    links = dict(zip(names, backend.link_poses(0, names), strict=True))
    solids = backend.solid_bodies()
    now = replace(now, solids=None if solids is None else solids.of(np.array([0])))
    return _with_solids(EpisodeReplay(now, "", shapes, lambda _: links))


def result(recording: Recording) -> tuple[str, bool]:
    """Return the result of an episode as a text, and whether it is a success."""
    text = "goal reached" if recording.reached else "goal not reached"
    succeeded = recording.reached and recording.task_done is not False
    return text + TASK_DONE[recording.task_done], succeeded


def _visible(backend: PhysicsBackend) -> tuple[list[VisualShape], list[LinkName]]:
    shapes = [
        shape
        for shape in visual_shapes(backend.robot, backend.scene)
        if shape.shape.kind != "box" or max(shape.shape.size) <= _WALL
    ]
    return shapes, list(dict.fromkeys(shape.link for shape in shapes))


def _with_solids(episode: EpisodeReplay) -> EpisodeReplay:
    solids = solid_shapes(episode.recording.solids)
    if not solids:
        return episode
    shapes = [
        VisualShape(link, replace(shape, pose=IDENTITY), colour) for link, shape, colour in solids
    ]

    def links(moment: int) -> Mapping[LinkName, Array]:
        present = solid_shapes(episode.recording.solids_at(moment))
        return {**episode.links(moment), **{solid.link: solid.shape.pose for solid in present}}

    return replace(episode, shapes=[*episode.shapes, *shapes], links=links)
