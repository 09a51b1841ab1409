"""The YAML text of a drafted robot, with comments that mark guesses."""

import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from kinfeas.robots.spec import ArmJointSpec, RobotSpec

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
    """Return the text of a robot's YAML file.

    Args:
        spec: Content of the file.
        guesses: Values that comments mark as guesses.
    """
    blocks = [_head(spec, guesses), _base(spec, guesses), _arm(spec, guesses)]
    if spec.gripper is not None:
        blocks.append(_gripper(spec, guesses))
    if spec.fixed_joints:
        blocks.append(_fixed(spec, guesses))
    heights = [_entry(name, band, "m") for name, band in spec.goal_heights.items()]
    blocks.append(["# Heights of reachable goals of any orientation.", "goal_heights:", *heights])
    if spec.pose_tolerance is not None:
        blocks.append(
            [
                "# Guess: the arm has fewer than six degrees of freedom.",
                "pose_tolerance:",
                _entry("position", spec.pose_tolerance.position, "m"),
                _entry("rotation", spec.pose_tolerance.rotation, "rad"),
            ]
        )
    if spec.ignored_collisions:
        blocks.append(
            [
                "# Guess: links that touch by design or whose shapes are too large, and the share",
                "# of configurations in which they touch.",
                "ignored_collisions:",
                *(
                    f"  - {_flow(pair)}{_comment(f'{guesses.touching.get(pair, 0.0):.0%}')}"
                    for pair in spec.ignored_collisions
                ),
            ]
        )
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


def _base(spec: RobotSpec, guesses: Guesses) -> list[str]:
    question = (
        f"# Is {_flow(guesses.stand)} a base that drives? It may be the arm's own first link."
    )
    return [
        "# Guess: the manual has the limits of the base.",
        *([question] if guesses.stand else []),
        "base:",
        *(_entry(key, value, _BASE_UNITS.get(key)) for key, value in vars(spec.base).items()),
    ]


def _arm(spec: RobotSpec, guesses: Guesses) -> list[str]:
    slides = any(name in guesses.slides for name in spec.arm)
    return [
        "arm:",
        *(
            f"  {_flow(name)}: {_joint(joint)}{_units(name, guesses)}"
            for name, joint in spec.arm.items()
        ),
        "",
        "# rad, or m where a joint slides" if slides else "# rad",
        "home:",
        *(_entry(name, at) for name, at in spec.home.items()),
    ]


def _joint(joint: ArmJointSpec) -> str:
    given = {"soft_limits": joint.soft_limits, "velocity": joint.velocity}
    return "{" + ", ".join(f"{key}: {_flow(x)}" for key, x in given.items() if x is not None) + "}"


def _units(joint: str, guesses: Guesses) -> str:
    unit = guesses.unit(joint)
    kinds = {unit: guesses.limits, f"{unit}/s": guesses.speeds}
    units = [one for one, joints in kinds.items() if joint in joints]
    return _comment(*units, "guess") if units else ""


def _gripper(spec: RobotSpec, guesses: Guesses) -> list[str]:
    values = vars(spec.gripper)
    unit = guesses.unit(values["fingers"][0])
    effort = "N" if unit == "m" else "N m"
    units = {"closed": unit, "open": unit, "effort": f"{effort}, the URDF's limit"}
    return ["gripper:", *(_entry(key, value, units.get(key)) for key, value in values.items())]


def _fixed(spec: RobotSpec, guesses: Guesses) -> list[str]:
    lines = (
        ["fixed_joints:"]
        if spec.gripper is None
        else ["# The gripper is half open.", "fixed_joints:"]
    )
    for name, at in spec.fixed_joints.items():
        why = "guess" if spec.gripper is None else None
        if name in guesses.stuck:
            why = "its limits leave it no room"
        lines.append(_entry(name, at, guesses.unit(name), why))
    return lines


def _entry(key: str, value: Any, *comment: str | None) -> str:
    return f"  {_flow(key)}: {_flow(value)}{_comment(*comment)}"


def _comment(*words: str | None) -> str:
    given = ", ".join(filter(None, words))
    return f"  # {given}" if given else ""


def _flow(value: Any) -> str:
    """Return a value in YAML's flow style."""
    if isinstance(value, str):
        plain = _PLAIN.fullmatch(value) and value.lower() not in _NOT_STRINGS
        return value if plain else json.dumps(value, ensure_ascii=False)
    if isinstance(value, float | int):
        short = f"{value:g}"
        return short if float(short) == value else repr(value)
    items: Iterable[Any] = value
    return f"[{', '.join(_flow(item) for item in items)}]"
