"""Which joints of a robot move in the PyBullet world, and which of them follow others."""

from collections.abc import Iterator
from dataclasses import dataclass

from kinfeas.robots.robot import Robot
from kinfeas.robots.tree import Joint, Urdf


@dataclass(frozen=True)
class Follower:
    """A joint that keeps to another: position = multiplier * position of leader + offset."""

    name: str
    leader: str
    multiplier: float
    offset: float


def moving_joints(robot: Robot) -> frozenset[str]:
    """Return the names of the joints that move; all others stand where `fixed_joints` says."""
    fingers = robot.gripper.fingers if robot.gripper else ()
    followers = (*arm_followers(robot), *finger_followers(robot))
    return frozenset(
        (*(joint.name for joint in robot.arm), *fingers, *(one.name for one in followers))
    )


def arm_followers(robot: Robot) -> tuple[Follower, ...]:
    """Return the joints that follow the arm's, as the torso of the HSR does."""
    arm = [joint.name for joint in robot.arm]
    return tuple(
        Follower(joint.name, leader.name, multiplier, offset)
        for joint in _mimics(robot.urdf)
        if joint.name not in robot.fixed_joints
        for leader, multiplier, offset in [robot.urdf.followed(joint)]
        if leader.name in arm
    )


def finger_followers(robot: Robot) -> tuple[Follower, ...]:
    """Return the joints of the fingers that follow the one that carries their finger.

    In a URDF all may follow one joint; here each finger has a motor of its own.
    """
    if robot.gripper is None:
        return ()
    found = []
    for finger in robot.gripper.fingers:
        links = robot.urdf.below(finger)
        motor, scale, shift = robot.urdf.followed(robot.urdf.joints[finger])
        for joint in _mimics(robot.urdf):
            leader, multiplier, offset = robot.urdf.followed(joint)
            if leader is motor and joint.parent in links:
                ratio = multiplier / scale
                found.append(Follower(joint.name, finger, ratio, offset - ratio * shift))
    return tuple(found)


def _mimics(urdf: Urdf) -> Iterator[Joint]:
    return (joint for joint in urdf.joints.values() if joint.moves and joint.mimic is not None)
