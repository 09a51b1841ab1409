"""The YAML text of a drafted robot, with comments that mark guesses."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, get_args

from kinfeas.config.strict_yaml import to_line
from kinfeas.robots.spec import Drive, RobotSpec

_FREE = 0.5
"""Fraction of configurations free of self-collision below which a warning says so."""

_DRIVES = f"--drive {' or '.join(get_args(Drive))} sets it"
_BASE_UNITS = {
    "max_velocity": "m/s", "max_rotation": "rad/s",
    "max_acceleration": "m/s^2", "max_rotation_acceleration": "rad/s^2",
}  # fmt: skip


@dataclass(frozen=True)
class Guesses:
    """Values of a draft that are not in its URDF."""

    lifted: float = 0.0  # height of the URDF's root above the floor, metres
    speeds: tuple[str, ...] = ()  # joints of arm and fingers without a velocity limit
    limits: tuple[str, ...] = ()  # arm joints of more than two turns that are not continuous
    stuck: tuple[str, ...] = ()  # joints on the path to the hand without a range of motion
    # fraction of configurations in which ignored, and in which checked pairs of links touch, 0-1
    touching: Mapping[tuple[str, str], float] = field(default_factory=dict)
    contacts: Mapping[tuple[str, str], float] = field(default_factory=dict)
    # fraction of configurations in which gravity exceeds a joint's effort limit, 0-1
    overloads: Mapping[str, float] = field(default_factory=dict)
    overloaded_at_home: tuple[str, ...] = ()  # joints whose effort limit gravity exceeds at home
    slides: frozenset[str] = frozenset()  # prismatic joints; their positions are metres
    drive: str = ""  # what the drive of the base was read from
    no_gripper: str = ""  # why there is no gripper
    weak_fingers: bool = False  # whether the fingers have no effort limit
    doubts: tuple[str, ...] = ()  # warnings about the URDF

    def unit(self, joint: str) -> str:
        """Return the unit of a joint's position."""
        return "m" if joint in self.slides else "rad"


def warnings(spec: RobotSpec, guesses: Guesses, free: float) -> list[str]:
    """Return warnings about a guessed drive, self-collisions and gravity loads of a draft.

    `free` is as of `Draft`.
    """
    messages = []
    if guesses.drive.startswith("a guess"):
        messages.append(f"the drive is {spec.base.drive}, {guesses.drive}; {_DRIVES}")
    if free < _FREE:
        often = sorted(guesses.contacts.items(), key=lambda entry: -entry[1])[:3]
        pairs = ", ".join(
            f"{first} and {second} in {fraction:.0%}" for (first, second), fraction in often
        )
        messages.append(
            f"{free:.0%} of random postures are free of self-collision; most often touch {pairs}"
        )
    if guesses.overloads:
        home = ", ".join(guesses.overloaded_at_home)
        rule = f"IK leaves them out (max_gravity_load: {spec.max_gravity_load})"
        if spec.max_gravity_load is None:
            rule = "IK does not leave them out, since hardly any others are free"
        messages.append(
            f"gravity exceeds the effort limit in random postures, {_overloads(guesses)}"
            f"{f', and at home ({home})' if home else ''}; {rule}"
        )
    return messages


def _overloads(guesses: Guesses) -> str:
    return ", ".join(f"{joint} in {fraction:.0%}" for joint, fraction in guesses.overloads.items())


def robot_yaml(spec: RobotSpec, guesses: Guesses) -> str:
    """Return the text of a robot's YAML file, with comments that mark guesses."""
    joints = {
        name: {key: value for key, value in vars(joint).items() if value is not None}
        for name, joint in spec.arm.items()
    }
    drive = " ".join(guesses.drive.split())
    blocks = [
        _head(spec, guesses),
        [
            "# Guess: the manual has the limits of the base.",
            *_block("base", vars(spec.base), _BASE_UNITS | {"drive": drive}),
        ],
        _block("arm", joints, {name: _guessed_units(name, guesses) for name in joints}),
        ["# rad, or m where a joint slides", *_block("home", spec.home)],
    ]
    if spec.gripper is not None:
        unit = guesses.unit(spec.gripper.fingers[0])
        source = "guess" if guesses.weak_fingers else "the URDF's limit"
        effort = f"{'N' if unit == 'm' else 'N m'}, {source}"
        units = {"closed": unit, "open": unit, "effort": effort, "velocity": f"{unit}/s, guess"}
        gripper = {key: value for key, value in vars(spec.gripper).items() if value is not None}
        blocks.append(_block("gripper", gripper, units))
    if spec.fixed_joints:
        title = [] if spec.gripper is None else ["# The gripper is half open."]
        why = {name: _fixed(name, spec, guesses) for name in spec.fixed_joints}
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
    if spec.max_gravity_load is not None:
        load = f"max_gravity_load: {spec.max_gravity_load}  # of the effort limit, guess"
        blocks.append([f"# Gravity exceeds effort limits: {_overloads(guesses)}.", load])
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


def _fixed(joint: str, spec: RobotSpec, guesses: Guesses) -> str:
    if joint in guesses.stuck:
        return f"{guesses.unit(joint)}, its limits leave it no room"
    return guesses.unit(joint) + (", guess" if spec.gripper is None else "")


def _block(
    key: str, values: Mapping[str, Any], comments: Mapping[str, str] | None = None
) -> list[str]:
    comment = {name: f"  # {text}" for name, text in (comments or {}).items() if text}
    entries = values.items()
    return [f"{key}:", *(f"  {to_line(k)}: {to_line(v)}{comment.get(k, '')}" for k, v in entries)]
