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


@dataclass(frozen=True)
class Guesses:
    """What stands in the YAML file though the URDF does not say so.

    Attributes:
        lifted: How far the URDF's own root is above the floor, metres.
        speeds: Arm joints to which the URDF gives no speed.
        limits: Arm joints that turn without end, but are not called continuous.
        touching: Share of configurations in which links touch that may, 0-1.
    """

    lifted: float = 0.0
    speeds: tuple[str, ...] = ()
    limits: tuple[str, ...] = ()
    touching: Mapping[tuple[str, str], float] = field(default_factory=dict)


def robot_yaml(spec: RobotSpec, guesses: Guesses) -> str:
    """Return the text of a robot's YAML file, which `read_robot` reads.

    Args:
        spec: What it says.
        guesses: What of that was guessed, which comments tell.
    """
    parts = (_head, _base, _arm, _gripper, _reach, _collisions)
    return "\n".join(line for part in parts for line in part(spec, guesses)) + "\n"


def _head(spec: RobotSpec, guesses: Guesses) -> Iterator[str]:
    yield f"# {spec.name}, drafted from its URDF. What is called a guess is not in there: look"
    yield "# at it. What each key means stands in docs/own_robot.md."
    yield f"name: {_flow(spec.name)}"
    if guesses.lifted:
        yield f"# A root on the floor was added to the URDF, {guesses.lifted:g} m below its own."
    yield f"urdf: {_flow(str(spec.urdf))}  # its shapes are primitives"
    yield f"ee_frame: {_flow(spec.ee_frame)}"
    yield f"tool_tip: {_flow(spec.tool_tip)}  # guess: where the fingers end"
    yield f"gripper_rotation: {_flow(spec.gripper_rotation)}  # guess: by where the fingers are"


def _base(spec: RobotSpec, guesses: Guesses) -> Iterator[str]:
    yield from ("", "# Guess: what the vendor allows stands in the manual.", "base:")
    for entry in fields(spec.base):
        yield f"  {entry.name}: {_flow(getattr(spec.base, entry.name))}"


def _arm(spec: RobotSpec, guesses: Guesses) -> Iterator[str]:
    yield from ("", "arm:")
    for name, joint in spec.arm.items():
        guess = "  # guess" if name in (*guesses.speeds, *guesses.limits) else ""
        yield f"  {_flow(name)}: {_joint(joint)}{guess}"
    yield from ("", "home:")
    yield from (f"  {_flow(name)}: {_flow(at)}" for name, at in spec.home.items())


def _joint(joint: ArmJointSpec) -> str:
    said = {"soft_limits": joint.soft_limits, "velocity": joint.velocity}
    return "{" + ", ".join(f"{key}: {_flow(x)}" for key, x in said.items() if x is not None) + "}"


def _gripper(spec: RobotSpec, guesses: Guesses) -> Iterator[str]:
    if spec.gripper is None:
        return
    yield from ("", "gripper:")
    for entry in fields(spec.gripper):
        yield f"  {entry.name}: {_flow(getattr(spec.gripper, entry.name))}"
    yield from ("", "# The gripper is half open.", "fixed_joints:")
    yield from (f"  {_flow(name)}: {_flow(at)}" for name, at in spec.fixed_joints.items())


def _reach(spec: RobotSpec, guesses: Guesses) -> Iterator[str]:
    yield from ("", "# Where goals of any orientation can be reached.", "goal_heights:")
    yield from (f"  {name}: {_flow(heights)}" for name, heights in spec.goal_heights.items())
    if spec.leeway is not None:
        yield from ("", "# Guess: these joints cannot follow six dimensions.", "leeway:")
        for entry in fields(spec.leeway):
            yield f"  {entry.name}: {_flow(getattr(spec.leeway, entry.name))}"


def _collisions(spec: RobotSpec, guesses: Guesses) -> Iterator[str]:
    if not spec.ignored_collisions:
        return
    yield from ("", "# Guess: links that are built to touch, or whose shapes are too wide, and the")
    yield from ("# share of configurations in which they do.", "ignored_collisions:")
    for pair in spec.ignored_collisions:
        yield f"  - {_flow(pair)}  # {guesses.touching[pair]:.0%}"


def _flow(value: Any) -> str:
    """Return a value as YAML writes it within a line."""
    if isinstance(value, str):
        plain = _PLAIN.fullmatch(value) and value.lower() not in _WORDS
        return value if plain else json.dumps(value, ensure_ascii=False)
    if isinstance(value, float | int):
        return f"{value:g}" if round(value, 4) == value else repr(value)
    return f"[{', '.join(_flow(item) for item in value)}]"
