"""Drafts of a robot's YAML and URDF from a vendor's URDF, xacro or MJCF."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np

from kinfeas import config
from kinfeas.config import strict_yaml
from kinfeas.core.errors import KinfeasError
from kinfeas.importer import reach
from kinfeas.importer.arm import Arm, Hand, effort_limits, ends_of_arms, find_arm, read_hand
from kinfeas.importer.boxed import Part, box_masses, boxed_urdf, on_the_floor, urdf_text
from kinfeas.importer.description import doubts, find_drive, read_description
from kinfeas.importer.text import Guesses, robot_yaml
from kinfeas.kinematics.forward import build_chain, forward
from kinfeas.kinematics.ik import POSE_DIMENSIONS
from kinfeas.robots.elements import Element
from kinfeas.robots.loading import build_robot
from kinfeas.robots.robot import Robot
from kinfeas.robots.spec import (
    GUESSED_VELOCITY,
    MAX_JOINT_VELOCITY,
    ArmJointSpec,
    BaseSpec,
    Drive,
    PoseTolerance,
    Reach,
    RobotSpec,
)
from kinfeas.robots.urdf import Joint, Urdf
from kinfeas.robots.urdf_file import urdf_of

_REACHED = (0.8, 0.4, 0.2)
"""Least fractions of reachable goals at the heights of a reach, in the order of preference."""

_BOXING, _TOUCHING, _REACHING = 0.3, 0.1, 0.6  # fractions of the work

_MAX_TURNS = 4.0 * math.pi + 0.01  # rad; a wider range stands for no limit
_HALF_TURN = 3.1416

_BASE_LIMITS = (0.2, 1.0, 1.0, 2.0)  # m/s, rad/s, m/s^2 and rad/s^2, as of the shipped robots
_ROTATION_TOLERANCE = 0.2094  # rad, of HSR


@dataclass(frozen=True, eq=False)
class Draft:
    """A drafted robot: content and text of its YAML file, and text of its URDF.

    `free` is the fraction of configurations without self-collision, 0-1.
    """

    spec: RobotSpec
    yaml: str
    urdf: str
    heights: reach.Heights
    free: float
    guesses: Guesses
    robot: Robot


def draft_robot(  # noqa: PLR0913 - each option is an argument
    path: Path,
    name: str,
    hand: str | None = None,
    base: str | None = None,
    drive: Drive | None = None,
    on_done: Callable[[float], None] | None = None,
    *,
    meshes: bool = True,
    mesh_paths: Mapping[str, str] | None = None,
    arguments: Mapping[str, str] | None = None,
) -> Draft:
    """Return the draft of a mobile manipulator.

    Args:
        path: Its URDF, xacro or MJCF, with or without meshes.
        name: Short name of the robot.
        hand: As of `find_arm`.
        base: As of `boxed_urdf`.
        drive: Drive of the base; by default read from its wheels or planar joints.
        on_done: Called with the fraction of all work, 0-1, that has just been done.
        meshes: Whether meshes are read.
        mesh_paths: Beginnings of mesh addresses, and their replacements.
        arguments: Arguments of a xacro.

    Raises:
        KinfeasError: If the file or one of its meshes is invalid, there is no arm or more than one,
            or the arm reaches hardly any goal.
    """
    report, source = on_done or (lambda fraction: None), str(path)
    with TemporaryDirectory(prefix="kinfeas-") as folder:
        description = read_description(
            path, Path(folder), meshes=meshes, mesh_paths=mesh_paths, arguments=arguments
        )
        boxed = _boxed(path, description, hand, base, report)
    urdf, arm = boxed.urdf, boxed.arm
    fingers = read_hand(urdf, arm)
    read_drive, why = find_drive(urdf, arm, urdf_of(description))
    bare_spec = spec_from_urdf(name, urdf, arm, fingers, drive or read_drive)
    bare = build_robot(bare_spec, urdf, path, path)
    touching = reach.touching(bare)
    ignored = reach.built_to_touch(bare, touching)
    checked = {pair: fraction for pair, fraction in touching.items() if pair not in ignored}
    ignored |= reach.only_fitted(bare, boxed.originals, checked)
    robot = replace(
        bare, pose_tolerance=pose_tolerance(bare),
        ignored_collisions=frozenset(map(frozenset, ignored)),
    )  # fmt: skip
    overloads = reach.overload_fractions(robot)
    if overloads:
        robot = reach.limited(robot)
    home = reach.comfortable(robot)
    report(_TOUCHING)
    heights = reach.useful_heights(robot, lambda fraction: report(_REACHING * fraction))
    spec = replace(
        bare_spec, home={"home": tuple(home.tolist())}, reach=reach_of(heights, source),
        pose_tolerance=robot.pose_tolerance, ignored_collisions=tuple(ignored),
        max_gravity_load=robot.max_gravity_load,
    )  # fmt: skip
    names = [joint.name for joint in arm.joints]
    moved = [*names, *(spec.gripper.fingers if spec.gripper else ())]
    guesses = Guesses(
        lifted=boxed.lifted,
        speeds=tuple(name for name in moved if _guessed_velocity(urdf.joints[name])),
        limits=tuple(name for name in names if spec.arm[name].soft_limits is not None),
        stuck=tuple(joint.name for joint in arm.stuck),
        touching=ignored,
        contacts={pair: fraction for pair, fraction in checked.items() if pair not in ignored},
        overloads=overloads,
        overloaded_at_home=reach.overloads_at(robot, home),
        slides=frozenset(n for n, joint in urdf.joints.items() if joint.kind == "prismatic"),
        drive="" if drive else why,
        no_gripper=fingers.no_gripper,
        weak_fingers=not effort_limits(arm.fingers),
        doubts=doubts(urdf, boxed.guessed),
    )
    yaml = robot_yaml(spec, guesses)
    read = config.from_mapping(RobotSpec, strict_yaml.parse(yaml, source), source)
    final = build_robot(read, urdf, path, path)
    return Draft(spec, yaml, boxed.text, heights, reach.free_fraction(robot), guesses, final)


class _Boxed(NamedTuple):
    """A description on the floor, of primitives."""

    text: str
    urdf: Urdf
    arm: Arm
    lifted: float  # metres
    originals: dict[str, list[Part]]  # parts that primitives replace, by link
    guessed: list[str]  # links whose shape is the box of their inertia


def _boxed(
    path: Path, description: Element, hand: str | None, base: str | None,
    report: Callable[[float], None],
) -> _Boxed:  # fmt: skip
    source, originals = str(path), dict[str, list[Part]]()
    links = len(description.children("link"))
    write = partial(boxed_urdf, description, path.absolute().parent, base)
    # A choice between arms comes before the work: fitting meshes takes most of the time.
    bare = urdf_of(write(fitted=()))
    if hand is not None:
        find_arm(bare, hand, source)
    elif ends := ends_of_arms(bare, source):
        find_arm(urdf_of(write(fitted=ends)), None, source)
    whole = write(on_link=lambda _: report(_BOXING / links), originals=originals)
    arm = find_arm(urdf_of(whole), hand, source)
    guessed, lifted = box_masses(whole, arm), on_the_floor(whole, arm)
    return _Boxed(urdf_text(whole), urdf_of(whole), arm, lifted, originals, guessed)


def reach_of(heights: reach.Heights, source: str) -> Reach:
    """Return the heights at which most goals are reachable."""
    for least in _REACHED:
        if band := heights.band(least):
            return Reach(*band)
    best = int(np.argmax(heights.fraction))
    raise KinfeasError(
        f"{source}: the arm reaches {_REACHED[-1]:.0%} of the goals at no range of heights: at "
        f"best {heights.fraction[best]:.0%}, {heights.at[best]:g} m above the floor; is the hand "
        "right?"
    )


def pose_tolerance(robot: Robot) -> PoseTolerance | None:
    """Return the pose tolerance of an arm that cannot move its EE in six dimensions, else None.

    The rotation is that of HSR. The position is the distance by which this rotation about the first
    joint moves an EE at its median horizontal distance from that joint: 0.1 m for HSR.
    """
    if reach.freedom(robot) == POSE_DIMENSIONS:
        return None
    chain = build_chain(robot)
    away = forward(chain, reach.sampled(robot))[:, :2] - chain.tree.offset[0, :2]
    distance = float(np.median(np.linalg.norm(away, axis=1)))
    return PoseTolerance(round(_ROTATION_TOLERANCE * distance, 3), _ROTATION_TOLERANCE)


def spec_from_urdf(name: str, urdf: Urdf, arm: Arm, hand: Hand, drive: Drive) -> RobotSpec:
    """Return the content of a robot's YAML file as far as the URDF gives it.

    The home is in the middle of the joint ranges, and the reach is a placeholder. No links may
    touch.
    """
    x, y, z = (round(float(number), 4) + 0.0 for number in hand.tip)
    joints = {}
    for joint in arm.joints:
        joints[joint.name] = ArmJointSpec(_one_turn(joint), _guessed_velocity(joint))
    gripper = hand.gripper
    if gripper is not None:
        speeds = [_guessed_velocity(urdf.joints[name]) for name in gripper.fingers]
        gripper = replace(gripper, velocity=speeds[0] if all(speeds) else None)
    return RobotSpec(
        name=name,
        ee_frame=arm.hand,
        tool_tip=(x, y, z),
        gripper_rotation=tuple(hand.rotation.round(7).tolist()),
        base=BaseSpec(drive, *_BASE_LIMITS),
        arm=joints,
        home={"home": tuple(_middle(joint, joints[joint.name]) for joint in arm.joints)},
        reach=Reach(0.2, 1.4),
        fixed_joints=_fixed(urdf, arm) | _half_open(urdf, hand),
        gripper=gripper,
    )


def _guessed_velocity(joint: Joint) -> float | None:
    """Return a velocity limit for a joint that has none, else None."""
    valid = 0.0 < joint.velocity <= MAX_JOINT_VELOCITY
    return None if valid else GUESSED_VELOCITY[joint.kind]


def _one_turn(joint: Joint) -> tuple[float, float] | None:
    """Return the turn nearest to 0 for a joint of more than two turns, else None."""
    lower, upper = joint.soft_lower, joint.soft_upper
    if joint.kind != "revolute" or upper - lower <= _MAX_TURNS:
        return None
    middle = min(max(0.0, lower + _HALF_TURN), upper - _HALF_TURN)
    low, high = round(middle - _HALF_TURN, 4), round(middle + _HALF_TURN, 4)
    return max(low, lower), min(high, upper)


def _middle(joint: Joint, spec: ArmJointSpec) -> float:
    lower, upper = spec.soft_limits or (joint.soft_lower, joint.soft_upper)
    return (lower + upper) / 2.0 if math.isfinite(upper - lower) else 0.0


def _fixed(urdf: Urdf, arm: Arm) -> dict[str, float]:
    """Return the positions of joints on the path to the hand that are not joints of the arm."""
    leaders = [urdf.followed(joint)[0] for joint in urdf.path_to(arm.hand) if joint.moves]
    moving = [joint.name for joint in arm.joints]
    return {
        leader.name: min(max(0.0, leader.soft_lower), leader.soft_upper)
        for leader in leaders
        if leader.name not in moving
    }


def _half_open(urdf: Urdf, hand: Hand) -> dict[str, float]:
    if hand.gripper is None:
        return {}
    closed, opened = hand.gripper.positions("close"), hand.gripper.positions("open")
    leaders = {}
    for finger in hand.gripper.fingers:
        leader, scale, offset = urdf.followed(urdf.joints[finger])
        middle = (closed[finger] + opened[finger]) / 2.0
        leaders[leader.name] = round((middle - offset) / scale, 4) + 0.0
    return dict(sorted(leaders.items()))
