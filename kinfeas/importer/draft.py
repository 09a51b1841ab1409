"""The draft of a robot: all that its URDF tells, in the two files that kinfeas reads."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from kinfeas import config
from kinfeas.config import strict_yaml
from kinfeas.core.errors import KinfeasError
from kinfeas.importer.arm import Arm, Hand, bare_stand, find_arm, read_hand
from kinfeas.importer.boxed import boxed_urdf, on_the_floor, read_robot_element
from kinfeas.importer.reach import (
    EASY,
    WORTH,
    Heights,
    built_to_touch,
    comfortable,
    free_share,
    freedom,
    useful_heights,
    with_pairs,
)
from kinfeas.importer.text import Guesses, robot_yaml
from kinfeas.kinematics.ik import POSE_DIMENSIONS
from kinfeas.robots.elements import parse_xml
from kinfeas.robots.loading import build_robot
from kinfeas.robots.robot import Robot
from kinfeas.robots.spec import (
    MAX_JOINT_VELOCITY,
    ArmJointSpec,
    BaseSpec,
    Drive,
    PoseTolerance,
    RobotSpec,
)
from kinfeas.robots.urdf import Joint, Urdf, urdf_of

_HARD = 0.2
"""Share of reachable goals below which no height is worth learning."""

_BOXING, _TOUCHING, _REACHING = 0.3, 0.1, 0.6
"""Shares of the work."""

Band = tuple[float, float]


@dataclass(frozen=True)
class DraftOptions:
    """What a URDF does not tell.

    Attributes:
        name: Short name of the robot; that of the URDF file by default.
        hand: Link that IK places; it is looked for by default.
        base: Link that becomes the root, with what it carries; it is looked for by default.
        drive: How the base moves.
    """

    name: str | None = None
    hand: str | None = None
    base: str | None = None
    drive: Drive = "differential"


@dataclass(frozen=True, eq=False)
class Draft:
    """A robot and the texts of its files.

    Attributes:
        spec: What its YAML file says.
        yaml: The text of that file.
        urdf: The text of its URDF.
        heights: Where goals can be reached.
        free: Share of configurations in which it does not touch itself, 0-1.
        guesses: What stands in the YAML file without being in the URDF.
        robot: What the files are read as.
    """

    spec: RobotSpec
    yaml: str
    urdf: str
    heights: Heights
    free: float
    guesses: Guesses
    robot: Robot


def draft_robot(
    path: Path, options: DraftOptions, on_done: Callable[[float], None] | None = None
) -> Draft:
    """Return what the URDF of a mobile manipulator tells, and guesses for the rest.

    Args:
        path: The URDF, with or without meshes.
        options: What it does not tell.
        on_done: Called with the share of all work, 0-1, that has just been done.

    Raises:
        KinfeasError: If the URDF or one of its meshes is broken, there is no arm or more than one,
            or the arm reaches hardly any goal.
    """
    tell = on_done or (lambda share: None)
    links = len(read_robot_element(path).children("link"))
    boxed = boxed_urdf(path, options.base, lambda _: tell(_BOXING / links))
    urdf, spec, guesses = _stated(path, boxed, options)
    robot = _read(spec, urdf, path)
    touching = built_to_touch(robot)
    pose_tolerance = POSE_TOLERANCE if freedom(robot) < POSE_DIMENSIONS else None
    robot = replace(with_pairs(robot, touching), pose_tolerance=pose_tolerance)
    home = comfortable(robot)
    tell(_TOUCHING)
    heights = useful_heights(robot, lambda share: tell(_REACHING * share))
    ggr, restricted = bands(heights, str(path))
    spec = replace(
        spec,
        home={"home": tuple(home.tolist())},
        goal_heights={"ggr": ggr, "ggr_restricted": restricted},
        pose_tolerance=pose_tolerance,
        ignored_collisions=tuple(touching),
    )
    guesses = replace(guesses, touching=touching)
    read = _read(spec, urdf, path)
    return Draft(spec, robot_yaml(spec, guesses), urdf, heights, free_share(robot), guesses, read)


def bands(heights: Heights, source: str) -> tuple[Band, Band]:
    """Return the heights that are worth learning, metres, and the comfortable ones.

    Raises:
        KinfeasError: If hardly any goal is reached but at a single height; it names `source`.
    """
    for least in (WORTH, WORTH / 2.0, _HARD):
        if band := heights.band(least):
            break
    else:
        best = int(np.argmax(heights.share))
        raise KinfeasError(
            f"{source}: the arm reaches {_HARD:.0%} of the goals at no range of heights: at best "
            f"{heights.share[best]:.0%}, {heights.at[best]:g} m above the floor; is the hand the "
            "link that it should be?"
        )
    quarter = (band[1] - band[0]) / 4.0
    middle = (round(band[0] + quarter, 3), round(band[1] - quarter, 3))
    return band, heights.band(EASY) or middle


def _stated(path: Path, boxed: str, options: DraftOptions) -> tuple[str, RobotSpec, Guesses]:
    """Return the text of the URDF, on the floor, and what it states; errors name `path`."""
    arm = find_arm(_parsed(boxed, path), options.hand, str(path))
    text, lifted = on_the_floor(boxed, arm, str(path))
    urdf = _parsed(text, path)
    spec = stated(options.name or path.stem, urdf, arm, read_hand(urdf, arm), options.drive)
    return text, spec, _guesses(spec, urdf, arm, lifted)


def _guesses(spec: RobotSpec, urdf: Urdf, arm: Arm, lifted: float) -> Guesses:
    names = [joint.name for joint in arm.joints]
    return Guesses(
        lifted=lifted,
        speeds=tuple(name for name in names if spec.arm[name].velocity is not None),
        limits=tuple(name for name in names if spec.arm[name].soft_limits is not None),
        stuck=tuple(joint.name for joint in arm.stuck),
        slides=frozenset(n for n, joint in urdf.joints.items() if joint.kind == "prismatic"),
        fingers=len(arm.fingers),
        stand=bare_stand(urdf, arm),
    )


def _read(spec: RobotSpec, urdf: str, path: Path) -> Robot:
    """Return the robot as kinfeas will read it from its files; errors name `path`."""
    source = str(path)
    told = strict_yaml.parse(robot_yaml(spec, Guesses()), source)
    spec = config.from_mapping(RobotSpec, told, source)
    return build_robot(spec, _parsed(urdf, path), path, source)


def _parsed(urdf: str, path: Path) -> Urdf:
    return urdf_of(parse_xml(urdf, "robot", str(path)))


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
    known = 0.0 < joint.velocity <= MAX_JOINT_VELOCITY
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
