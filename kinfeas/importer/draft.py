"""Drafts of a robot's YAML and URDF from a vendor's URDF, with comments that mark guesses."""

import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from kinfeas import config
from kinfeas.config import strict_yaml
from kinfeas.config.strict_yaml import to_line
from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import Array, rotation
from kinfeas.importer.arm import Arm, Hand, find_arm, read_hand
from kinfeas.importer.boxed import Part, boxed_urdf, on_the_floor, read_description
from kinfeas.importer.reach import (
    Heights,
    built_to_touch,
    comfortable,
    free_fraction,
    freedom,
    only_fitted,
    touching,
    useful_heights,
    with_pairs,
)
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
    Reach,
    RobotSpec,
)
from kinfeas.robots.urdf import Joint, Urdf
from kinfeas.robots.urdf_file import urdf_of

_OMNIDIRECTIONAL = re.compile(r"mecanum|omni|swerve|holonomic", re.IGNORECASE)
_CASTER = re.compile(r"cast[eo]r", re.IGNORECASE)
_UPRIGHT, _LEVEL, _PARALLEL = 0.9, 0.2, 0.98  # cosines of angles, to the vertical or between axes
_LONGEST = 5.0  # m; longer links are more likely in other units
_LISTED = 5  # names in a message at most

_FREE = 0.5
"""Fraction of configurations free of self-collision below which a warning says so."""

_BASE_UNITS = {
    "max_velocity": "m/s",
    "max_rotation": "rad/s",
    "max_acceleration": "m/s^2",
    "max_rotation_acceleration": "rad/s^2",
}


@dataclass(frozen=True)
class Guesses:
    """Values of a draft that are not in its URDF.

    Attributes:
        lifted: Height of the URDF's root above the floor, metres.
        speeds: Arm joints without a velocity limit.
        limits: Arm joints of more than two turns that are not continuous.
        stuck: Joints on the way to the hand whose limits leave no range of motion.
        touching: Fraction of configurations in which the ignored pairs of links touch, 0-1.
        contacts: The same of the pairs that are checked.
        slides: Prismatic joints; their positions are metres.
        drive: What the drive of the base was read from.
        no_gripper: Why there is no gripper.
        doubts: Warnings about the URDF.
    """

    lifted: float = 0.0
    speeds: tuple[str, ...] = ()
    limits: tuple[str, ...] = ()
    stuck: tuple[str, ...] = ()
    touching: Mapping[tuple[str, str], float] = field(default_factory=dict)
    contacts: Mapping[tuple[str, str], float] = field(default_factory=dict)
    slides: frozenset[str] = frozenset()
    drive: str = ""
    no_gripper: str = ""
    doubts: tuple[str, ...] = ()

    def unit(self, joint: str) -> str:
        """Return the unit of a joint's position."""
        return "m" if joint in self.slides else "rad"


def warnings(guesses: Guesses, free: float) -> list[str]:
    """Return the doubts about a draft, and what limits its postures; `free` is as of `Draft`."""
    if free >= _FREE:
        return [*guesses.doubts]
    often = sorted(guesses.contacts.items(), key=lambda entry: -entry[1])[:3]
    pairs = ", ".join(f"{first} and {second} in {part:.0%}" for (first, second), part in often)
    return [
        *guesses.doubts,
        f"{free:.0%} of random postures are free of self-collision; most often touch {pairs}",
    ]


def robot_yaml(spec: RobotSpec, guesses: Guesses) -> str:
    """Return the text of a robot's YAML file, with comments that mark guesses."""
    joints = {
        name: {key: value for key, value in vars(joint).items() if value is not None}
        for name, joint in spec.arm.items()
    }
    blocks = [
        _head(spec, guesses),
        [
            "# Guess: the manual has the limits of the base.",
            *_block(
                "base", vars(spec.base), _BASE_UNITS | {"drive": " ".join(guesses.drive.split())}
            ),
        ],
        _block("arm", joints, {name: _guessed_units(name, guesses) for name in joints}),
        ["# rad, or m where a joint slides", *_block("home", spec.home)],
    ]
    if spec.gripper is not None:
        unit = guesses.unit(spec.gripper.fingers[0])
        effort = f"{'N' if unit == 'm' else 'N m'}, the URDF's limit"
        units = {"closed": unit, "open": unit, "effort": effort}
        blocks.append(_block("gripper", vars(spec.gripper), units))
    if spec.fixed_joints:
        title = [] if spec.gripper is None else ["# The gripper is half open."]
        why = {name: _fixed_comment(name, spec, guesses) for name in spec.fixed_joints}
        blocks.append([*title, *_block("fixed_joints", spec.fixed_joints, why)])
    reach = f"reach: {{low: {spec.reach.low:g}, high: {spec.reach.high:g}}}"
    blocks.append(["# Heights at which most goals are reachable, in any orientation, m.", reach])
    if spec.pose_tolerance is not None:
        tolerance = _block(
            "pose_tolerance", vars(spec.pose_tolerance), {"position": "m", "rotation": "rad"}
        )
        blocks.append(["# Guess: the arm has fewer than six degrees of freedom.", *tolerance])
    if spec.ignored_collisions:
        pairs = [f"  - {to_line(p)}  # {guesses.touching[p]:.0%}" for p in spec.ignored_collisions]
        about = "# Guess: links that touch by design or by too large shapes, and how often they do."
        blocks.append([about, "ignored_collisions:", *pairs])
    return "\n\n".join("\n".join(block) for block in blocks) + "\n"


def _head(spec: RobotSpec, guesses: Guesses) -> list[str]:
    lifted = f"# A root on the floor was added to the URDF, {guesses.lifted:g} m below its own."
    return [
        f"# {spec.name}, drafted from its URDF. Check all guesses.",
        "# The shapes in robot.urdf are primitives.",
        "# docs/reference/formats.md describes the keys.",
        f"name: {to_line(spec.name)}",
        *([lifted] if guesses.lifted else []),
        f"ee_frame: {to_line(spec.ee_frame)}",
        f"tool_tip: {to_line(spec.tool_tip)}  # m, guess",
        f"gripper_rotation: {to_line(spec.gripper_rotation)}  # x y z w, guess",
    ]


def _guessed_units(joint: str, guesses: Guesses) -> str:
    unit = guesses.unit(joint)
    kinds = {unit: guesses.limits, f"{unit}/s": guesses.speeds}
    units = [unit_name for unit_name, joints in kinds.items() if joint in joints]
    return ", ".join([*units, "guess"]) if units else ""


def _fixed_comment(joint: str, spec: RobotSpec, guesses: Guesses) -> str:
    if joint in guesses.stuck:
        return f"{guesses.unit(joint)}, its limits leave it no room"
    return guesses.unit(joint) + (", guess" if spec.gripper is None else "")


def _block(
    key: str, values: Mapping[str, Any], comments: Mapping[str, str] | None = None
) -> list[str]:
    comment = {name: f"  # {text}" for name, text in (comments or {}).items() if text}
    entries = values.items()
    return [f"{key}:", *(f"  {to_line(k)}: {to_line(v)}{comment.get(k, '')}" for k, v in entries)]


_REACHED = (0.8, 0.4, 0.2)
"""Fractions of reachable goals at the heights of a reach; a lower one where there is no range."""

_BOXING, _TOUCHING, _REACHING = 0.3, 0.1, 0.6  # fractions of the work

_MAX_TURNS = 4.0 * math.pi + 0.01  # rad; a wider range stands for no limit
_HALF_TURN = 3.1416
_VELOCITY = {"revolute": 1.0, "continuous": 1.0, "prismatic": 0.1}  # rad/s or m/s, if none is given

# Limits of the shipped robots' bases, and HSR's pose tolerance.
_BASE_LIMITS = (0.2, 1.0, 1.0, 2.0)
_POSE_TOLERANCE = PoseTolerance(position=0.1, rotation=0.2094)


@dataclass(frozen=True, eq=False)
class Draft:
    """A drafted robot: content and text of its YAML file, and text of its URDF.

    `free` is the fraction of configurations without self-collision, 0-1.
    """

    spec: RobotSpec
    yaml: str
    urdf: str
    heights: Heights
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
) -> Draft:
    """Return the draft of a mobile manipulator.

    Args:
        path: Its URDF, with or without meshes.
        name: Short name of the robot.
        hand: As of `find_arm`.
        base: As of `boxed_urdf`.
        drive: Drive of the base; by default read from its wheels.
        on_done: Called with the fraction of all work, 0-1, that has just been done.
        meshes: Whether meshes are read.
        mesh_paths: Beginnings of mesh addresses, and their replacements.

    Raises:
        KinfeasError: If the URDF or one of its meshes is invalid, there is no arm or more than one,
            or the arm reaches hardly any goal.
    """
    report, source = on_done or (lambda fraction: None), str(path)
    description = read_description(path, meshes=meshes, mesh_paths=mesh_paths)
    links = len(description.children("link"))
    originals: dict[str, list[Part]] = {}
    whole = boxed_urdf(path, base, lambda _: report(_BOXING / links), description, originals)
    arm = find_arm(_parsed(whole, source), hand, source)
    text, lifted = on_the_floor(whole, arm, source)
    urdf = _parsed(text, source)
    fingers = read_hand(urdf, arm)
    wheel_drive, why = find_drive(urdf, arm)
    spec = stated(name, urdf, arm, fingers, drive or wheel_drive)
    robot = build_robot(spec, urdf, path, path)
    fractions = touching(robot)
    ignored = built_to_touch(robot, fractions)
    checked = {pair: fraction for pair, fraction in fractions.items() if pair not in ignored}
    false = only_fitted(robot, originals, checked)
    ignored |= false
    pose_tolerance = _POSE_TOLERANCE if freedom(robot) < POSE_DIMENSIONS else None
    robot = replace(with_pairs(robot, ignored), pose_tolerance=pose_tolerance)
    home = comfortable(robot)
    report(_TOUCHING)
    heights = useful_heights(robot, lambda fraction: report(_REACHING * fraction))
    spec = replace(
        spec,
        home={"home": tuple(home.tolist())},
        reach=reach_of(heights, source),
        pose_tolerance=pose_tolerance,
        ignored_collisions=tuple(ignored),
    )
    names = [joint.name for joint in arm.joints]
    guesses = Guesses(
        lifted=lifted,
        speeds=tuple(name for name in names if spec.arm[name].velocity is not None),
        limits=tuple(name for name in names if spec.arm[name].soft_limits is not None),
        stuck=tuple(joint.name for joint in arm.stuck),
        touching=ignored,
        contacts={pair: fraction for pair, fraction in checked.items() if pair not in false},
        slides=frozenset(n for n, joint in urdf.joints.items() if joint.kind == "prismatic"),
        drive="" if drive else why,
        no_gripper=fingers.no_gripper,
        doubts=doubts(urdf),
    )
    yaml = robot_yaml(spec, guesses)
    read = config.from_mapping(RobotSpec, strict_yaml.parse(yaml, source), source)
    final = build_robot(read, urdf, path, path)
    return Draft(spec, yaml, text, heights, free_fraction(robot), guesses, final)


def _parsed(text: str, source: str) -> Urdf:
    return urdf_of(parse_xml(text, "robot", source))


def reach_of(heights: Heights, source: str) -> Reach:
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


def stated(name: str, urdf: Urdf, arm: Arm, hand: Hand, drive: Drive) -> RobotSpec:
    """Return the content of a robot's YAML file as far as the URDF gives it.

    The home is in the middle of the joint ranges, and the reach is a placeholder. No links may
    touch.
    """
    x, y, z = (round(float(number), 4) + 0.0 for number in hand.tip)
    joints = {
        joint.name: ArmJointSpec(
            soft_limits=_one_turn(joint),
            velocity=None if 0.0 < joint.velocity <= MAX_JOINT_VELOCITY else _VELOCITY[joint.kind],
        )
        for joint in arm.joints
    }
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
        gripper=hand.gripper,
    )


def _one_turn(joint: Joint) -> tuple[float, float] | None:
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
    """Return the positions of joints on the way to the hand that are not joints of the arm."""
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


def find_drive(urdf: Urdf, arm: Arm) -> tuple[Drive, str]:
    """Return the drive of a base and what it was read from: names and axes of its wheels.

    Without wheels it is differential, a guess.
    """
    base = set(urdf.links) - urdf.below(arm.joints[0].name)
    joints = [joint for joint in urdf.joints.values() if joint.child in base]
    names = [*sorted(base), *(joint.name for joint in joints)]
    if named := [name for name in names if _OMNIDIRECTIONAL.search(name)]:
        return "omnidirectional", f"the name {named[0]}"
    axes = {joint.name: _axis(urdf, joint) for joint in joints if joint.moves}
    wheels = [
        wheel
        for wheel in joints
        if wheel.kind == "continuous" and abs(axes[wheel.name][2]) < _LEVEL
    ]
    if driven := [wheel for wheel in wheels if not _CASTER.search(wheel.name + wheel.child)]:
        wheels = driven  # the others follow
    steering = {wheel.name: _steering(urdf, wheel, axes) for wheel in wheels}
    fixed = [wheel for wheel in wheels if steering[wheel.name] is None]
    listed = _listed(wheel.name for wheel in wheels)
    if not wheels:
        return "differential", "a guess: no wheel has a joint"
    if not fixed:
        return "omnidirectional", f"wheels steered by {_listed(filter(None, steering.values()))}"
    parallel = [abs(axes[fixed[0].name] @ axes[wheel.name]) > _PARALLEL for wheel in fixed]
    if not all(parallel):
        return "omnidirectional", f"wheels in several directions: {listed}"
    if len(wheels) == 2:
        return "differential", f"two driven wheels: {listed}"
    return "differential", f"a guess: {len(wheels)} wheels, perhaps mecanum or steered: {listed}"


def _axis(urdf: Urdf, joint: Joint) -> Array:
    axis: Array = rotation(urdf.link_poses({})[joint.child]).apply(joint.axis)
    return axis


def _steering(urdf: Urdf, wheel: Joint, axes: Mapping[str, Array]) -> str | None:
    above = (
        joint.name
        for joint in urdf.path_to(wheel.parent)
        if joint.kind in ("revolute", "continuous")
    )
    return next((name for name in above if abs(axes[name][2]) > _UPRIGHT), None)


def doubts(urdf: Urdf) -> tuple[str, ...]:
    """Return warnings about a URDF whose lengths or masses are probably wrong."""
    warnings = []
    sizes = {
        name: max((max(shape.size) for shape in link.shapes), default=0.0)
        for name, link in urdf.links.items()
    }
    if large := [name for name, size in sizes.items() if size > _LONGEST]:
        warnings.append(
            f"{_listed(large)} up to {max(sizes.values()):.0f} m long: if meshes are in "
            'millimetres, <mesh> needs scale="0.001 0.001 0.001"'
        )
    bodies = dict.fromkeys(urdf.rigid.values())
    light = [
        next(name for name in urdf.links if name in body and urdf.links[name].shapes)
        for body in bodies
        if not any(urdf.links[name].mass for name in body)
        and any(urdf.links[name].shapes for name in body)
    ]
    if light:
        warnings.append(
            f"{_listed(light)} without mass: --world pybullet and mujoco need an <inertial>"
        )
    return tuple(warnings)


def _listed(names: Iterable[str]) -> str:
    every = list(dict.fromkeys(names))
    more = f" and {len(every) - _LISTED} more" if len(every) > _LISTED else ""
    return ", ".join(every[:_LISTED]) + more
