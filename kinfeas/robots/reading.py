"""A robot from its YAML file and the URDF that this names, checked against each other."""

import math
from collections.abc import Collection
from pathlib import Path

import numpy as np

from kinfeas import config
from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import Array
from kinfeas.robots.positions import fixed_positions
from kinfeas.robots.robot import ArmJoint, Base, Robot
from kinfeas.robots.spec import FASTEST_JOINT, Gripper, RobotSpec
from kinfeas.robots.tree import Joint, Urdf
from kinfeas.robots.urdf import parse_urdf


def read_robot(path: Path) -> Robot:
    """Return the robot that a YAML file, and the URDF that it names, describe.

    Args:
        path: File with the keys of `spec.RobotSpec`.

    Raises:
        KinfeasError: If one of the files is broken, or they do not fit each other.
    """
    spec = config.load(RobotSpec, path)
    urdf_path = path.parent / spec.urdf
    return build_robot(spec, parse_urdf(urdf_path), urdf_path, str(path))


def build_robot(spec: RobotSpec, urdf: Urdf, urdf_path: Path, source: str) -> Robot:
    """Return the robot that is described so.

    Args:
        spec: What its YAML says.
        urdf: What its URDF says.
        urdf_path: File that physics engines load.
        source: Where the YAML is from, for errors.

    Raises:
        KinfeasError: If the two do not fit each other.
    """
    _check_chain(spec, urdf, source)
    _check_followers(spec, urdf, source)
    arm = tuple(_arm_joint(spec, urdf.joints[name], source) for name in spec.arm)
    rotation = np.array(spec.gripper_rotation)
    return Robot(
        name=spec.name,
        urdf_path=urdf_path,
        urdf=urdf,
        ee_frame=spec.ee_frame,
        tool_tip=np.array(spec.tool_tip),
        gripper_rotation=rotation / np.linalg.norm(rotation),
        base=_base(spec, urdf),
        arm=arm,
        fixed_joints=fixed_positions(urdf, spec.arm, spec.fixed_joints, source),
        home={
            name: _configuration(arm, name, positions, source)
            for name, positions in spec.home.items()
        },
        goal_heights=spec.goal_heights,
        pose_tolerance=spec.pose_tolerance,
        ignored_collisions=_pairs(spec, urdf, source),
        gripper=_gripper(spec, urdf, source),
        counterbalanced=_counterbalanced(spec, source),
    )


def _check_chain(spec: RobotSpec, urdf: Urdf, source: str) -> None:
    """Check that the arm's joints, and no others that move freely, lead to the EE frame."""
    _check_link(urdf.links, spec.ee_frame, f"{source}: 'ee_frame'")
    for name in spec.arm:
        where = f"{source}: 'arm.{name}'"
        if name not in urdf.joints:
            raise KinfeasError(
                f"{where}: there is no such joint{config.no_such(name, urdf.joints)}"
            )
        if not urdf.joints[name].moves or urdf.joints[name].mimic:
            raise KinfeasError(f"{where}: the joint does not move by itself")
    moving = [joint for joint in urdf.path_to(spec.ee_frame) if joint.moves]
    order = [joint.name for joint in moving if joint.name in spec.arm]
    if order != list(spec.arm):
        way = f"those on the way from {urdf.root!r} to {spec.ee_frame!r}"
        known = ", ".join(joint.name for joint in moving) or "none"
        raise KinfeasError(f"{source}: the joints of 'arm' must be {way}, in order, of {known}")
    for joint in moving:
        if urdf.followed(joint)[0].name not in (*spec.arm, *spec.fixed_joints):
            raise KinfeasError(
                f"{source}: joint {joint.name!r}, on the way to {spec.ee_frame!r}, must stand in "
                "'arm' or 'fixed_joints', or follow one that does"
            )


def _check_followers(spec: RobotSpec, urdf: Urdf, source: str) -> None:
    """Check that what follows an endless joint of the arm stands as before after a whole turn."""
    for joint in urdf.joints.values():
        leader, scale, _ = urdf.followed(joint)
        comes_round = joint.kind != "prismatic" and scale.is_integer()
        if leader.name in spec.arm and leader.kind == "continuous" and not comes_round:
            raise KinfeasError(
                f"{source}: 'arm.{leader.name}': a turn of it changes where {joint.name!r} stands, "
                "which follows it, so the URDF must make it revolute and give it limits"
            )


def _arm_joint(spec: RobotSpec, joint: Joint, source: str) -> ArmJoint:
    block, where = spec.arm[joint.name], f"{source}: 'arm.{joint.name}'"
    velocity = joint.velocity if block.velocity is None else block.velocity
    if not 0.0 < velocity <= FASTEST_JOINT:
        raise KinfeasError(
            f"{where}: the URDF gives no velocity above 0 and up to {FASTEST_JOINT:g}, so "
            "'velocity' must"
        )
    if joint.kind == "continuous":
        if block.soft_limits is not None:
            raise KinfeasError(f"{where}: a continuous joint has no 'soft_limits'")
        return ArmJoint(joint.name, -math.inf, math.inf, velocity, continuous=True)
    lower, upper = block.soft_limits or (joint.soft_lower, joint.soft_upper)
    if lower >= upper:
        raise KinfeasError(
            f"{where}: the lower limit must be below the upper one, not {lower:g} and {upper:g}"
        )
    if not joint.lower <= lower < upper <= joint.upper:
        raise KinfeasError(
            f"{where}: the soft limits {lower:g} to {upper:g} must lie in the URDF's "
            f"{joint.lower:g} to {joint.upper:g}"
        )
    return ArmJoint(joint.name, lower, upper, velocity, continuous=False)


def _base(spec: RobotSpec, urdf: Urdf) -> Base:
    base = spec.base
    return Base(
        drive=base.drive,
        max_velocity=base.max_velocity,
        max_rotation=base.max_rotation,
        max_acceleration=base.max_acceleration,
        max_rotation_acceleration=base.max_rotation_acceleration,
        frame=urdf.root,
    )


def _configuration(
    arm: tuple[ArmJoint, ...], name: str, positions: tuple[float, ...], source: str
) -> Array:
    where = f"{source}: 'home.{name}'"
    if len(positions) != len(arm):
        raise KinfeasError(f"{where}: must hold {len(arm)} joint positions, not {len(positions)}")
    for joint, position in zip(arm, positions, strict=True):
        if not joint.lower <= position <= joint.upper:
            raise KinfeasError(
                f"{where}: {joint.name} at {position:g} is beyond its soft limits "
                f"{joint.lower:g} to {joint.upper:g}"
            )
    return np.array(positions)


def _pairs(spec: RobotSpec, urdf: Urdf, source: str) -> frozenset[frozenset[str]]:
    where = f"{source}: 'ignored_collisions'"
    for pair in spec.ignored_collisions:
        for link in pair:
            _check_link(urdf.links, link, where)
        if pair[0] == pair[1]:
            raise KinfeasError(f"{where}: must hold pairs of two links, not {pair[0]!r} twice")
    return frozenset(map(frozenset, spec.ignored_collisions))


def _gripper(spec: RobotSpec, urdf: Urdf, source: str) -> Gripper | None:
    if spec.gripper is None:
        return None
    where = f"{source}: 'gripper.fingers'"
    for name in spec.gripper.fingers:
        if name not in urdf.joints:
            raise KinfeasError(
                f"{where}: there is no such joint{config.no_such(name, urdf.joints)}"
            )
        joint = urdf.joints[name]
        if not joint.moves or name in spec.arm:
            raise KinfeasError(f"{where}: {name!r} must be a moving joint that is not of the arm")
        for position in (spec.gripper.closed, spec.gripper.open):
            if not joint.lower <= position <= joint.upper:
                allowed = f"{joint.lower:g} to {joint.upper:g}"
                raise KinfeasError(
                    f"{source}: 'gripper': {position:g} is beyond the limits of {name}, {allowed}"
                )
    return spec.gripper


def _counterbalanced(spec: RobotSpec, source: str) -> frozenset[str]:
    for name in spec.counterbalanced:
        if name not in spec.arm:
            known = ", ".join(spec.arm)
            raise KinfeasError(
                f"{source}: 'counterbalanced': {name!r} is no joint of 'arm', which are {known}"
            )
    return frozenset(spec.counterbalanced)


def _check_link(links: Collection[str], name: str, where: str) -> None:
    if name not in links:
        raise KinfeasError(f"{where}: there is no link {name!r}{config.no_such(name, links)}")
