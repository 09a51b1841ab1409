"""The YAML text of a drafted robot, with comments that mark guesses."""

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from kinfeas.robots.spec import RobotSpec

_PLAIN = re.compile(r"[A-Za-z][\w./-]*")
_NOT_STRINGS = {"y", "n", "yes", "no", "on", "off", "true", "false", "null"}

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
        touching: Share of configurations in which the ignored pairs of links touch, 0-1.
        slides: Prismatic joints; their positions are metres.
        fingers: Number of fingers from which tool tip and axes were found.
        stand: Link below the arm that may be the arm's own first link, else empty.
    """

    lifted: float = 0.0
    speeds: tuple[str, ...] = ()
    limits: tuple[str, ...] = ()
    stuck: tuple[str, ...] = ()
    touching: Mapping[tuple[str, str], float] = field(default_factory=dict)
    slides: frozenset[str] = frozenset()
    fingers: int = 0
    stand: str = ""

    def unit(self, joint: str) -> str:
        """Return the unit of a joint's position."""
        return "m" if joint in self.slides else "rad"

    def hand(self) -> tuple[str, str]:
        """Return the rules by which the tip and the axes of the hand were found."""
        if self.fingers > 1:
            return "where the fingers end", "by where the fingers are"
        if self.fingers == 1:
            return "as far as the hand reaches", "by how its jaw closes"
        return "as far as the hand reaches", "no fingers; x away from the arm, y arbitrary"


def guessed(spec: RobotSpec, guesses: Guesses) -> dict[str, str]:
    """Return the guessed values with units or rules, by their keys in the YAML file."""
    tip, turned = guesses.hand()
    found = {
        f"base.{key}": " ".join([_flow(value), _BASE_UNITS.get(key, "")]).strip()
        for key, value in vars(spec.base).items()
    }
    found["tool_tip"] = f"{_flow(spec.tool_tip)} m: {tip}"
    found["gripper_rotation"] = f"{_flow(spec.gripper_rotation)}: {turned}"
    for name in guesses.limits:
        limits = spec.arm[name].soft_limits
        found[f"arm.{name}.soft_limits"] = f"{_flow(limits)} {guesses.unit(name)}"
    for name in guesses.speeds:
        found[f"arm.{name}.velocity"] = f"{_flow(spec.arm[name].velocity)} {guesses.unit(name)}/s"
    if spec.pose_tolerance is not None:
        tolerance = spec.pose_tolerance
        found["pose_tolerance"] = f"{tolerance.position:g} m, {tolerance.rotation:g} rad"
    if spec.ignored_collisions:
        found["ignored_collisions"] = f"{len(spec.ignored_collisions)} pairs of links"
    return found


def robot_yaml(spec: RobotSpec, guesses: Guesses) -> str:
    """Return the text of a robot's YAML file, with comments that mark guesses."""
    joints = {
        name: {key: value for key, value in vars(joint).items() if value is not None}
        for name, joint in spec.arm.items()
    }
    slides = any(name in guesses.slides for name in spec.arm)
    question = (
        f"# Is {_flow(guesses.stand)} a base that drives? It may be the arm's own first link."
    )
    blocks = [
        _head(spec, guesses),
        [
            "# Guess: the manual has the limits of the base.",
            *([question] if guesses.stand else []),
            *_block("base", vars(spec.base), _BASE_UNITS),
        ],
        _block("arm", joints, {name: _guessed_units(name, guesses) for name in joints}),
        ["# rad, or m where a joint slides" if slides else "# rad", *_block("home", spec.home)],
    ]
    if spec.gripper is not None:
        unit = guesses.unit(spec.gripper.fingers[0])
        effort = f"{'N' if unit == 'm' else 'N m'}, the URDF's limit"
        units = {"closed": unit, "open": unit, "effort": effort}
        blocks.append(_block("gripper", vars(spec.gripper), units))
    if spec.fixed_joints:
        title = [] if spec.gripper is None else ["# The gripper is half open."]
        why = {name: _fixed(name, spec, guesses) for name in spec.fixed_joints}
        blocks.append([*title, *_block("fixed_joints", spec.fixed_joints, why)])
    heights = _block("goal_heights", spec.goal_heights, dict.fromkeys(spec.goal_heights, "m"))
    blocks.append(["# Heights of reachable goals of any orientation.", *heights])
    if spec.pose_tolerance is not None:
        tolerance = _block(
            "pose_tolerance", vars(spec.pose_tolerance), {"position": "m", "rotation": "rad"}
        )
        blocks.append(["# Guess: the arm has fewer than six degrees of freedom.", *tolerance])
    if spec.ignored_collisions:
        pairs = [f"  - {_flow(p)}  # {guesses.touching[p]:.0%}" for p in spec.ignored_collisions]
        about = "# Guess: links that touch by design or by too large shapes, and how often they do."
        blocks.append([about, "ignored_collisions:", *pairs])
    return "\n\n".join("\n".join(block) for block in blocks) + "\n"


def _head(spec: RobotSpec, guesses: Guesses) -> list[str]:
    tip, turned = guesses.hand()
    lifted = f"# A root on the floor was added to the URDF, {guesses.lifted:g} m below its own."
    return [
        f"# {spec.name}, drafted from its URDF. Check all guesses.",
        "# docs/own_robot.md describes the keys.",
        f"name: {_flow(spec.name)}",
        *([lifted] if guesses.lifted else []),
        f"urdf: {_flow(str(spec.urdf))}  # its shapes are primitives",
        f"ee_frame: {_flow(spec.ee_frame)}",
        f"tool_tip: {_flow(spec.tool_tip)}  # m, guess: {tip}",
        f"gripper_rotation: {_flow(spec.gripper_rotation)}  # x y z w, guess: {turned}",
    ]


def _guessed_units(joint: str, guesses: Guesses) -> str:
    unit = guesses.unit(joint)
    kinds = {unit: guesses.limits, f"{unit}/s": guesses.speeds}
    units = [one for one, joints in kinds.items() if joint in joints]
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
    return [f"{key}:", *(f"  {_flow(k)}: {_flow(v)}{comment.get(k, '')}" for k, v in entries)]


def _flow(value: Any) -> str:
    """Return a value in YAML's flow style."""
    if isinstance(value, str):
        plain = _PLAIN.fullmatch(value) and value.lower() not in _NOT_STRINGS
        return value if plain else json.dumps(value, ensure_ascii=False)
    if isinstance(value, float | int):
        short = f"{value:g}"
        return short if float(short) == value else repr(value)
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_flow(key)}: {_flow(one)}" for key, one in value.items()) + "}"
    return f"[{', '.join(map(_flow, value))}]"
