"""Robots by name or path: `robot.yaml` and the URDF, checked against each other."""

import math
from collections.abc import Collection
from pathlib import Path

import numpy as np

from kinfeas import config
from kinfeas.config.recipes import robot_file
from kinfeas.core.errors import KinfeasError, no_such
from kinfeas.core.spatial import Array
from kinfeas.robots.robot import ArmJoint, Base, Robot
from kinfeas.robots.spec import MAX_JOINT_VELOCITY, GripperSpec, RobotSpec
from kinfeas.robots.urdf import Joint, Urdf
from kinfeas.robots.urdf_file import parse_urdf


def load_robot(name_or_path: str | Path) -> Robot:
    """Return the robot of an entry point (`pr2`) or of a folder (`robots/mine`).

    Its file `robot.yaml`, whose path is accepted as well, has the keys of `spec.RobotSpec`.

    Raises:
        KinfeasError: If there is no such robot, its YAML or URDF is wrong, or a URDF is named in
            place of the folder.
    """
    check_no_urdf(name_or_path)
    path = robot_file(name_or_path)
    spec = config.load(RobotSpec, path)
    urdf_path = path.parent / spec.urdf
    return build_robot(spec, parse_urdf(urdf_path), urdf_path, path)


def check_no_urdf(name_or_path: object) -> None:
    """Raise `KinfeasError` if a robot is a URDF, xacro or MJCF in place of a folder."""
    path = Path(str(name_or_path))
    if path.suffix.lower() in (".urdf", ".xacro", ".xml"):
        raise KinfeasError(
            f"{path}: a robot is a folder; `kinfeas robot import {path} --out DIR` makes one"
        )


def build_robot(spec: RobotSpec, urdf: Urdf, urdf_path: Path, path: Path) -> Robot:
    """Return the robot of a specification and its URDF.

    Args:
        spec: Content of its `robot.yaml`.
        urdf: Its links and joints.
        urdf_path: URDF file for physics engines.
        path: File of the specification, in the folder of the robot; errors begin with it.
    """
    source = str(path)
    _check_chain(spec, urdf, source)
    arm = tuple(_arm_joint(spec, urdf, urdf.joints[name], source) for name in spec.arm)
    rotation = np.array(spec.gripper_rotation)
    home = {
        name: _configuration(arm, positions, f"{source}: 'home.{name}'")
        for name, positions in spec.home.items()
    }
    for name in spec.counterbalanced:
        _check_known(name, spec.arm, "arm joint", f"{source}: 'counterbalanced'")
    return Robot(
        name=spec.name, folder=path.parent, urdf_path=urdf_path, urdf=urdf,
        ee_frame=spec.ee_frame, tool_tip=np.array(spec.tool_tip),
        gripper_rotation=rotation / np.linalg.norm(rotation),
        base=Base(**vars(spec.base), frame=urdf.root),
        arm=arm, fixed_joints=_fixed_joints(spec, urdf, source), home=home,
        reach=spec.reach, pose_tolerance=spec.pose_tolerance,
        ignored_collisions=_pairs(spec, urdf, f"{source}: 'ignored_collisions'"),
        gripper=_gripper(spec, urdf, source), counterbalanced=frozenset(spec.counterbalanced),
        max_gravity_load=spec.max_gravity_load, response=spec.response,
    )  # fmt: skip


def _check_known(name: str, names: Collection[str], kind: str, where: str) -> None:
    if name not in names:
        raise KinfeasError(f"{where}: there is no {kind} {name!r}{no_such(name, names)}")


def _check_chain(spec: RobotSpec, urdf: Urdf, source: str) -> None:
    """Check that the joints from the root to the EE frame are those of `arm`, or fixed."""
    _check_known(spec.ee_frame, urdf.links, "link", f"{source}: 'ee_frame'")
    for name in spec.arm:
        where = f"{source}: 'arm.{name}'"
        _check_known(name, urdf.joints, "joint", where)
        if not urdf.joints[name].moves or urdf.joints[name].mimic:
            raise KinfeasError(f"{where}: the joint is fixed or a mimic joint")
    moving = [joint for joint in urdf.path_to(spec.ee_frame) if joint.moves]
    if [joint.name for joint in moving if joint.name in spec.arm] != list(spec.arm):
        names = ", ".join(joint.name for joint in moving) or "none"
        raise KinfeasError(
            f"{source}: 'arm' must name joints between {urdf.root!r} and {spec.ee_frame!r}, in "
            f"order, of {names}"
        )
    for joint in moving:
        if urdf.followed(joint)[0].name not in (*spec.arm, *spec.fixed_joints):
            raise KinfeasError(
                f"{source}: joint {joint.name!r}, above {spec.ee_frame!r}, must be in 'arm' or "
                "'fixed_joints', or mimic one that is"
            )


def _arm_joint(spec: RobotSpec, urdf: Urdf, joint: Joint, source: str) -> ArmJoint:
    block, where = spec.arm[joint.name], f"{source}: 'arm.{joint.name}'"
    velocity = joint.velocity if block.velocity is None else block.velocity
    if not 0.0 < velocity <= MAX_JOINT_VELOCITY:
        raise KinfeasError(
            f"{where}: 'velocity' is missing, and the URDF has none in (0, {MAX_JOINT_VELOCITY:g}]"
        )
    if joint.kind == "continuous":
        if block.soft_limits is not None:
            raise KinfeasError(f"{where}: a continuous joint has no 'soft_limits'")
        if _is_periodic(urdf, joint):
            return ArmJoint(joint.name, -math.inf, math.inf, velocity, continuous=True)
        return ArmJoint(joint.name, -math.pi, math.pi, velocity, continuous=False)
    lower, upper = block.soft_limits or (joint.soft_lower, joint.soft_upper)
    if not joint.lower <= lower < upper <= joint.upper:
        raise KinfeasError(
            f"{where}: the soft limits {lower:g} to {upper:g} must ascend and lie in the URDF's "
            f"{joint.lower:g} to {joint.upper:g}"
        )
    return ArmJoint(joint.name, lower, upper, velocity, continuous=False)


def _is_periodic(urdf: Urdf, leader: Joint) -> bool:
    """Return whether a full turn of a continuous joint brings all joints that mimic it back."""
    followers = ((joint, *urdf.followed(joint)) for joint in urdf.joints.values())
    return all(
        joint.kind != "prismatic" and scale.is_integer()
        for joint, followed, scale, _ in followers
        if followed is leader
    )


def _configuration(arm: tuple[ArmJoint, ...], positions: tuple[float, ...], where: str) -> Array:
    if len(positions) != len(arm):
        raise KinfeasError(f"{where}: must hold {len(arm)} joint positions, not {len(positions)}")
    for joint, position in zip(arm, positions, strict=True):
        _check_within(position, joint.lower, joint.upper, f"{where}: {joint.name}")
    return np.array(positions)


def _check_within(position: float, lower: float, upper: float, where: str) -> None:
    if not lower <= position <= upper:
        raise KinfeasError(f"{where}: {position:g} is not in [{lower:g}, {upper:g}]")


def _fixed_joints(spec: RobotSpec, urdf: Urdf, source: str) -> dict[str, float]:
    """Return the position of every moving joint that is neither of the arm nor mimics it."""
    for name, position in spec.fixed_joints.items():
        where = f"{source}: 'fixed_joints.{name}'"
        _check_known(name, urdf.joints, "joint", where)
        joint = urdf.joints[name]
        if name in spec.arm or not joint.moves or joint.mimic is not None:
            raise KinfeasError(f"{where}: the joint is in 'arm', fixed or a mimic joint")
        _check_within(position, joint.lower, joint.upper, where)
    positions = {}
    for joint in urdf.joints.values():
        leader, scale, offset = urdf.followed(joint)
        if joint.moves and leader.name not in spec.arm:
            position = spec.fixed_joints.get(leader.name, leader.rest)
            positions[joint.name] = scale * position + offset
    return positions


def _pairs(spec: RobotSpec, urdf: Urdf, where: str) -> frozenset[frozenset[str]]:
    for pair in spec.ignored_collisions:
        for link in pair:
            _check_known(link, urdf.links, "link", where)
        if len(set(pair)) < 2:
            raise KinfeasError(f"{where}: must hold pairs of two links, not {pair[0]!r} twice")
    return frozenset(map(frozenset, spec.ignored_collisions))


def _gripper(spec: RobotSpec, urdf: Urdf, source: str) -> GripperSpec | None:
    if spec.gripper is None:
        return None
    for name in spec.gripper.fingers:
        where = f"{source}: 'gripper.fingers'"
        _check_known(name, urdf.joints, "joint", where)
        joint = urdf.joints[name]
        if not joint.moves or name in spec.arm:
            raise KinfeasError(f"{where}: {name!r} must be a moving joint that is not in 'arm'")
        closed, opened = (spec.gripper.positions(grip)[name] for grip in ("close", "open"))
        for key, position in (("closed", closed), ("open", opened)):
            _check_within(position, joint.lower, joint.upper, f"{source}: 'gripper.{key}', {name}")
    return spec.gripper
