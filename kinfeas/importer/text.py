"""The YAML file of a robot, with a word on what was guessed."""

import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields
from typing import Any

from kinfeas.robots.spec import ArmJointSpec, RobotSpec

_PLAIN = re.compile(r"[A-Za-z][\w./-]*")
_WORDS = {"y", "n", "yes", "no", "on", "off", "true", "false", "null"}
"""Which YAML takes for something else."""

_BASE_UNITS = {
    "max_velocity": "m/s",
    "max_rotation": "rad/s",
    "max_acceleration": "m/s^2",
    "max_rotation_acceleration": "rad/s^2",
}


@dataclass(frozen=True)
class Guesses:
    """What stands in the YAML file though the URDF does not say so, and what comments are made of.

    Attributes:
        lifted: How far the URDF's own root is above the floor, metres.
        speeds: Arm joints to which the URDF gives no speed.
        limits: Arm joints that turn without end, but are not called continuous.
        stuck: Joints on the way to the hand whose limits leave them no room.
        touching: Share of configurations in which links touch that may, 0-1.
        slides: Joints whose positions are metres; those of the others are radians.
        fingers: How many fingers the hand has, by which its tip and its axes were found.
        stand: The link that the arm is on, if that may be the arm's own first link; else nothing.
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


def robot_yaml(spec: RobotSpec, guesses: Guesses) -> str:
    """Return the text of a robot's YAML file, which `read_robot` reads.

    Args:
        spec: What it says.
        guesses: What of that was guessed, which comments tell.
    """
    parts = (_head, _base, _arm, _gripper, _fixed, _reach, _collisions)
    return "\n".join(line for part in parts for line in part(spec, guesses)) + "\n"


def guessed(spec: RobotSpec, guesses: Guesses) -> dict[str, str]:
    """Return the guesses by their keys in the YAML file, with units or how they were found."""
    tip, turned = _hand(guesses.fingers)
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
        found["pose_tolerance"] = (
            f"{spec.pose_tolerance.position:g} m, {spec.pose_tolerance.rotation:g} rad"
        )
    if spec.ignored_collisions:
        found["ignored_collisions"] = f"{len(spec.ignored_collisions)} pairs of links"
    return found


def _head(spec: RobotSpec, guesses: Guesses) -> Iterator[str]:
    yield f"# {spec.name}, drafted from its URDF. What is called a guess is not in there: look"
    yield "# at it. What each key means stands in docs/own_robot.md."
    yield f"name: {_flow(spec.name)}"
    if guesses.lifted:
        yield f"# A root on the floor was added to the URDF, {guesses.lifted:g} m below its own."
    yield f"urdf: {_flow(str(spec.urdf))}  # its shapes are primitives"
    yield f"ee_frame: {_flow(spec.ee_frame)}"
    tip, turned = _hand(guesses.fingers)
    yield f"tool_tip: {_flow(spec.tool_tip)}  # m, guess: {tip}"
    yield f"gripper_rotation: {_flow(spec.gripper_rotation)}  # x y z w, guess: {turned}"


def _hand(fingers: int) -> tuple[str, str]:
    """Return by what the tip and the axes of a hand were found."""
    if fingers > 1:
        return "where the fingers end", "by where the fingers are"
    if fingers == 1:
        return "as far as the hand reaches", "by how its jaw closes"
    return "as far as the hand reaches", "no fingers; x away from the arm, y arbitrary"


def _base(spec: RobotSpec, guesses: Guesses) -> Iterator[str]:
    yield from ("", "# Guess: what the vendor allows stands in the manual.")
    if guesses.stand:
        yield f"# Is {_flow(guesses.stand)} a base that drives? It may be the arm's own first link."
    yield "base:"
    for entry in fields(spec.base):
        value = _flow(getattr(spec.base, entry.name))
        yield f"  {entry.name}: {value}{_comment(_BASE_UNITS.get(entry.name))}"


def _arm(spec: RobotSpec, guesses: Guesses) -> Iterator[str]:
    yield from ("", "arm:")
    for name, joint in spec.arm.items():
        yield f"  {_flow(name)}: {_joint(joint)}{_guessed(name, guesses)}"
    slides = any(name in guesses.slides for name in spec.arm)
    yield from ("", "# rad, or m where a joint slides" if slides else "# rad", "home:")
    yield from (f"  {_flow(name)}: {_flow(at)}" for name, at in spec.home.items())


def _guessed(joint: str, guesses: Guesses) -> str:
    """Return the comment on an arm joint: the units of what was guessed, if anything was."""
    unit = guesses.unit(joint)
    kinds = {unit: guesses.limits, f"{unit}/s": guesses.speeds}
    units = [one for one, joints in kinds.items() if joint in joints]
    return _comment(*units, "guess") if units else ""


def _joint(joint: ArmJointSpec) -> str:
    said = {"soft_limits": joint.soft_limits, "velocity": joint.velocity}
    return "{" + ", ".join(f"{key}: {_flow(x)}" for key, x in said.items() if x is not None) + "}"


def _gripper(spec: RobotSpec, guesses: Guesses) -> Iterator[str]:
    if spec.gripper is None:
        return
    unit = guesses.unit(spec.gripper.fingers[0])
    effort = "N" if unit == "m" else "N m"
    units = {"closed": unit, "open": unit, "effort": f"{effort}, the URDF's limit"}
    yield from ("", "gripper:")
    for entry in fields(spec.gripper):
        value = _flow(getattr(spec.gripper, entry.name))
        yield f"  {entry.name}: {value}{_comment(units.get(entry.name))}"


def _fixed(spec: RobotSpec, guesses: Guesses) -> Iterator[str]:
    if not spec.fixed_joints:
        return
    yield ""
    if spec.gripper is not None:
        yield "# The gripper is half open."
    yield "fixed_joints:"
    for name, at in spec.fixed_joints.items():
        why = "guess" if spec.gripper is None else None
        if name in guesses.stuck:
            why = "its limits leave it no room"
        yield f"  {_flow(name)}: {_flow(at)}{_comment(guesses.unit(name), why)}"


def _reach(spec: RobotSpec, guesses: Guesses) -> Iterator[str]:
    yield from ("", "# Where goals of any orientation can be reached.", "goal_heights:")
    yield from (f"  {name}: {_flow(heights)}  # m" for name, heights in spec.goal_heights.items())
    if spec.pose_tolerance is not None:
        yield from ("", "# Guess: these joints cannot follow six dimensions.", "pose_tolerance:")
        yield f"  position: {_flow(spec.pose_tolerance.position)}  # m"
        yield f"  rotation: {_flow(spec.pose_tolerance.rotation)}  # rad"


def _collisions(spec: RobotSpec, guesses: Guesses) -> Iterator[str]:
    if not spec.ignored_collisions:
        return
    yield from ("", "# Guess: links that are built to touch, or whose shapes are too wide, and the")
    yield from ("# share of configurations in which they do.", "ignored_collisions:")
    for pair in spec.ignored_collisions:
        yield f"  - {_flow(pair)}  # {guesses.touching[pair]:.0%}"


def _comment(*words: str | None) -> str:
    """Return words as a comment at the end of a line; nothing if there are none."""
    told = ", ".join(filter(None, words))
    return f"  # {told}" if told else ""


def _flow(value: Any) -> str:
    """Return a value as YAML writes it within a line."""
    if isinstance(value, str):
        plain = _PLAIN.fullmatch(value) and value.lower() not in _WORDS
        return value if plain else json.dumps(value, ensure_ascii=False)
    if isinstance(value, float | int):
        short = f"{value:g}"
        return short if float(short) == value else repr(value)
    return f"[{', '.join(_flow(item) for item in value)}]"
