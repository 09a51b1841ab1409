"""Recorded runs, ready to be drawn as episodes are."""

from textwrap import fill

import numpy as np
from matplotlib.figure import Figure

from kinfeas.core import spatial
from kinfeas.core.errors import KinfeasError
from kinfeas.evaluation.recording import Recording
from kinfeas.io.run_log import REACHED, Record
from kinfeas.kinematics.forward import build_chain, forward
from kinfeas.robots.robot import Robot
from kinfeas.scenes.scene import Scene, read_scene
from kinfeas.viz.pictures.episodes import episodes_figure

_WIDTH = 50  # characters of the title's lines


def recording(record: Record, robot: Robot) -> Recording:
    """Return a recorded run as an episode; the achieved EE is what the measured joints say.

    Raises:
        KinfeasError: If it is of a robot with another arm.
    """
    joints = tuple(joint.name for joint in robot.arm)
    if record.about.joints != joints:
        raise KinfeasError(
            f"the record is of the joints {', '.join(record.about.joints)}, but the arm of robot "
            f"{robot.name!r} has {', '.join(joints)}"
        )
    ee = forward(build_chain(robot), record.joint_positions)
    last = [np.flatnonzero(record.subgoal == subgoal)[-1] for subgoal in np.unique(record.subgoal)]
    return Recording(
        episode=0,
        base_pose=record.base_pose,
        joint_positions=record.joint_positions,
        desired=record.desired,
        ee_pose=spatial.compose(record.base_pose, ee),
        feasible=record.feasible,
        goals=record.goal[last],
        reached=record.event[-1].startswith(REACHED),
        dt=record.about.dt,
    )


def scene_of(record: Record) -> Scene | None:
    """Return the furniture around a run as it stood at its start; None if there was none.

    Raises:
        KinfeasError: If the scene or an object of it is not there.
    """
    if not record.about.scene:
        return None
    poses = {name: np.array(pose) for name, pose in record.about.objects.items()}
    return read_scene(record.about.scene).with_poses(poses)


def replay_figure(record: Record, robot: Robot) -> Figure:
    """Return a picture of a run, from the side and from above, with the furniture near by.

    Raises:
        KinfeasError: If it is of a robot with another arm, or its scene is not there.
    """
    seconds = record.time[-1] - record.time[0]
    title = f"{robot.name}, {record.about.task}, {seconds:.0f} s: {ending(record)}"
    episode = recording(record, robot)
    return episodes_figure(robot, [episode], [fill(title, _WIDTH)], scene_of(record))


def ending(record: Record) -> str:
    """Return how a run ended."""
    return record.event[-1] or "the record breaks off"
