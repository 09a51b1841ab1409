"""Robots by name or path."""

import math
import shlex
from collections.abc import Collection, Mapping
from pathlib import Path

import numpy as np

from kinfeas import config
from kinfeas.core import registry
from kinfeas.core.errors import KinfeasError, no_such
from kinfeas.core.spatial import Array
from kinfeas.io.files import is_path
from kinfeas.robots.robot import ArmJoint, Base, Robot
from kinfeas.robots.spec import FASTEST_JOINT, Gripper, RobotSpec
from kinfeas.robots.urdf import Joint, Urdf, parse_urdf


def load_robot(name_or_path: str) -> Robot:
    """Return the robot of a YAML file (`my/robot.yaml`) or of an entry point (`pr2`).

    Raises:
        KinfeasError: If there is no such robot, its YAML or URDF is wrong, or a URDF is named in
            place of the YAML.
    """
    check_no_urdf(name_or_path)
    path = Path(name_or_path) if is_path(name_or_path) else _robot_yaml(name_or_path)
    return read_robot(path)


def _robot_yaml(name: str) -> Path:
    built = registry.build("kinfeas.robots", name, {})
    if not isinstance(built, Path):
        raise KinfeasError(f"robot {name!r} must return the Path of its YAML, not {built!r}")
    return built


def check_no_urdf(name_or_path: object) -> None:
    """Check that what is to name a robot is no URDF, nor what becomes one.

    Raises:
        KinfeasError: If it is; it tells the command that makes the YAML.
    """
    path = Path(str(name_or_path))
    if path.suffix.lower() not in (".urdf", ".xacro"):
        return
    urdf, first = path, ""
    if path.suffix.lower() == ".xacro":
        urdf = path.with_suffix("" if path.stem.endswith(".urdf") else ".urdf")
        first = f"{shlex.join(['xacro', str(path)])} > {shlex.quote(str(urdf))} and then "
    command = shlex.join(["kinfeas", "robot", "import", str(urdf), "--out", "FOLDER"])
    raise KinfeasError(f"{path}: a robot is a YAML file, which {first}{command} writes")


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
            raise KinfeasError(f"{where}: there is no such joint{no_such(name, urdf.joints)}")
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
            raise KinfeasError(f"{where}: there is no such joint{no_such(name, urdf.joints)}")
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
        raise KinfeasError(f"{where}: there is no link {name!r}{no_such(name, links)}")


def fixed_positions(
    urdf: Urdf, arm: Collection[str], given: Mapping[str, float], source: str
) -> dict[str, float]:
    """Return the position of every joint that moves but does not depend on the arm.

    Args:
        urdf: The robot.
        arm: Names of the arm's joints.
        given: Positions by joint; other joints follow another one or are as near 0 as they can.
        source: File name for the error.

    Raises:
        KinfeasError: If `given` names an unknown joint or one that is not free to be set, or a
            position beyond the hard limits.
    """
    for name, position in given.items():
        _check_given(urdf, arm, name, position, f"{source}: 'fixed_joints.{name}'")
    return {
        joint.name: _position(urdf, joint, given)
        for joint in urdf.joints.values()
        if joint.moves and urdf.followed(joint)[0].name not in arm
    }


def _check_given(urdf: Urdf, arm: Collection[str], name: str, position: float, where: str) -> None:
    if name not in urdf.joints:
        raise KinfeasError(f"{where}: there is no such joint{no_such(name, urdf.joints)}")
    joint = urdf.joints[name]
    if name in arm:
        raise KinfeasError(f"{where}: the joint stands in 'arm', too")
    if not joint.moves:
        raise KinfeasError(f"{where}: the joint does not move")
    if joint.mimic is not None:
        raise KinfeasError(f"{where}: the joint follows {joint.mimic.joint!r}, set that one")
    if not joint.lower <= position <= joint.upper:
        allowed = f"{joint.lower:g} to {joint.upper:g}"
        raise KinfeasError(f"{where}: {position:g} is beyond the limits {allowed}")


def _position(urdf: Urdf, joint: Joint, given: Mapping[str, float]) -> float:
    leader, scale, offset = urdf.followed(joint)
    return scale * given.get(leader.name, min(max(0.0, leader.lower), leader.upper)) + offset
