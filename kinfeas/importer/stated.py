"""What a URDF states of a robot by itself, as its YAML file has it."""

import math
from pathlib import Path

import numpy as np

from kinfeas.importer.arm import Arm
from kinfeas.importer.hand import Hand
from kinfeas.robots.spec import (
    FASTEST_JOINT,
    ArmJointSpec,
    BaseSpec,
    Drive,
    PoseTolerance,
    RobotSpec,
)
from kinfeas.robots.urdf import Joint, Urdf

_WIDEST = 4.0 * math.pi + 0.01
"""Radians: a wider range than a turn either way stands for no limit."""

_HALF_TURN = 3.1416

_TURN, _SLIDE = 1.0, 0.1
"""rad/s and m/s of joints to which the URDF gives no speed."""

# What the shipped robots have in common, and HSR's pose_tolerance for arms that cannot reach every
# pose.
_SPEED, _ROTATION, _ACCELERATION, _ROTATION_ACCELERATION = 0.2, 1.0, 1.0, 2.0
POSE_TOLERANCE = PoseTolerance(position=0.1, rotation=0.2094)
_HEIGHTS = {"ggr": (0.2, 1.4), "ggr_restricted": (0.4, 1.1)}


def stated(name: str, urdf: Urdf, arm: Arm, hand: Hand, drive: Drive) -> RobotSpec:
    """Return the YAML file of a robot, with stopgaps for what has to be tried out.

    These are the home, in the middle of the joint ranges, the goal heights, pairs of links that may
    touch, none, and no pose_tolerance.
    """
    joints = {joint.name: _joint(joint) for joint in arm.joints}
    return RobotSpec(
        name=name,
        urdf=Path(f"{name}.urdf"),
        ee_frame=arm.hand,
        tool_tip=_triple(hand.tip),
        gripper_rotation=tuple(hand.rotation.round(7).tolist()),
        base=BaseSpec(drive, _SPEED, _ROTATION, _ACCELERATION, _ROTATION_ACCELERATION),
        arm=joints,
        home={"home": tuple(_middle(joint, joints[joint.name]) for joint in arm.joints)},
        goal_heights=_HEIGHTS,
        fixed_joints=_still(urdf, arm) | _half_open(urdf, hand),
        gripper=hand.gripper,
    )


def _joint(joint: Joint) -> ArmJointSpec:
    known = 0.0 < joint.velocity <= FASTEST_JOINT
    return ArmJointSpec(
        soft_limits=_one_turn(joint),
        velocity=None if known else _SLIDE if joint.kind == "prismatic" else _TURN,
    )


def _one_turn(joint: Joint) -> tuple[float, float] | None:
    """Return the turn about 0, or as near to it as may be, of a joint of more than two turns."""
    lower, upper = joint.soft_lower, joint.soft_upper
    if joint.kind != "revolute" or upper - lower <= _WIDEST:
        return None
    middle = min(max(0.0, lower + _HALF_TURN), upper - _HALF_TURN)
    low, high = round(middle - _HALF_TURN, 4), round(middle + _HALF_TURN, 4)
    return max(low, lower), min(high, upper)


def _middle(joint: Joint, spec: ArmJointSpec) -> float:
    lower, upper = spec.soft_limits or (joint.soft_lower, joint.soft_upper)
    return (lower + upper) / 2.0 if math.isfinite(upper - lower) else 0.0


def _still(urdf: Urdf, arm: Arm) -> dict[str, float]:
    """Return where joints stand on which the hand hangs, though they are not of the arm.

    They have no room, or lie off the way to the hand but are followed by joints on it.
    """
    leaders = [urdf.followed(joint)[0] for joint in urdf.path_to(arm.hand) if joint.moves]
    moving = [joint.name for joint in arm.joints]
    return {
        one.name: min(max(0.0, one.soft_lower), one.soft_upper)
        for one in leaders
        if one.name not in moving
    }


def _half_open(urdf: Urdf, hand: Hand) -> dict[str, float]:
    """Return where the joints stand that move the fingers."""
    if hand.gripper is None:
        return {}
    leaders = {urdf.followed(urdf.joints[finger])[0].name for finger in hand.gripper.fingers}
    return dict.fromkeys(sorted(leaders), round((hand.gripper.closed + hand.gripper.open) / 2.0, 4))


def _triple(vector: np.ndarray) -> tuple[float, float, float]:
    x, y, z = (round(float(number), 4) + 0.0 for number in vector)
    return x, y, z
