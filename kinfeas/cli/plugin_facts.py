"""What can be said of a plugin: its summary, its parameters, and what it is made of."""

import inspect
import re
from collections.abc import Callable, Collection
from dataclasses import MISSING, dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any

from kinfeas.cli.docstrings import Docstring, read_docstring, unit
from kinfeas.config import strict_yaml
from kinfeas.core import registry
from kinfeas.core.errors import KinfeasError, no_such, plugin_note
from kinfeas.core.registry import GROUPS, Plugin
from kinfeas.robots.loading import check_no_urdf, load_robot

_BY_NAME = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
# What the program itself gives.
_HANDED_IN = {"kinfeas.adapters": ("backend", "robot"), "kinfeas.backends": ("robot",)}


@dataclass(frozen=True)
class Parameter:
    """One keyword parameter.

    Attributes:
        name: Its name.
        type: Its type, as annotated; empty if it is not.
        unit: Symbol of the unit that its description names first, or nothing.
        default: What it is by default; None if it has to be given.
        description: One line.
    """

    name: str
    type: str
    unit: str
    default: str | None
    description: str


def summary(plugin: Plugin) -> tuple[str, str | None]:
    """Return what a plugin is, in a line, and why it is broken, if it is."""
    try:
        loaded = _load(plugin)
        if plugin.group == "kinfeas.robots":
            robot = load_robot(plugin.name)
            return f"{robot.base.drive} base, arm of {len(robot.arm)} joints", None
        with plugin_note(str(plugin)):
            return read_docstring(loaded).summary, None
    except KinfeasError as error:
        return "", " ".join(str(error).split())


def find(name: str) -> list[Plugin]:
    """Return the plugins of a name, at most one of each group.

    Raises:
        KinfeasError: If there is none, or one is claimed twice.
    """
    every = [plugin for group in GROUPS for plugin in registry.plugins(group)]
    found = [plugin for plugin in every if plugin.name == name]
    if not found:
        known = no_such(name, sorted({plugin.name for plugin in every}))
        raise KinfeasError(f"there is no plugin {name!r}{known}")
    for plugin in found:
        registry.check_unique(plugin.group, plugin.name)
    return found


def facts(plugin: Plugin) -> dict[str, Any]:
    """Return all that can be said of a plugin, in plain data.

    Raises:
        KinfeasError: If it is broken.
    """
    loaded = _load(plugin)
    with plugin_note(str(plugin)):
        said = read_docstring(loaded)
    known: dict[str, Any] = {**vars(plugin), "kind": GROUPS[plugin.group], "text": said.text}
    if plugin.group == "kinfeas.robots":
        return known | {"robot": _robot(plugin.name)}
    with plugin_note(str(plugin)):
        found = parameters(loaded, said, _HANDED_IN.get(plugin.group, ()))
    if plugin.group == "kinfeas.tasks" and all(one.default is not None for one in found):
        return known | _task(plugin.name, found)
    return known | {"parameters": [vars(one) for one in found]}


def facts_of_file(path: str) -> dict[str, Any]:
    """Return all that can be said of the robot or the task that a YAML file describes.

    Raises:
        KinfeasError: If it describes neither, or is broken.
    """
    check_no_urdf(path)
    keys = strict_yaml.read(Path(path)).keys()
    if "subgoals" in keys:
        from kinfeas.tasks.loading import task_name

        return {"kind": "task", "name": task_name(path), "file": path, **_task(path, [])}
    if "urdf" in keys:
        robot = _robot(path)
        return {"kind": "robot", "name": robot["name"], "file": path, "robot": robot}
    raise KinfeasError(
        f"{path}: describes no robot, which has the key 'urdf', and no task, which has 'subgoals'"
    )


def parameters(
    factory: Callable[..., Any], said: Docstring, without: Collection[str] = ()
) -> list[Parameter]:
    """Return the keyword parameters of a class or function, in their order.

    Args:
        factory: What is called with them.
        said: Its docstring.
        without: Names of those that are not told.
    """
    taken = [p for p in inspect.signature(factory).parameters.values() if p.kind in _BY_NAME]
    return [
        _parameter(p.name, p.annotation, _default(p.default, p.empty), said)
        for p in taken
        if p.name not in without
    ]


def fields_of(built: object) -> list[Parameter]:
    """Return the fields of a dataclass with their values, or nothing for another object."""
    if not is_dataclass(built):
        return []
    said = read_docstring(type(built))
    return [
        _parameter(one.name, one.type, _text(getattr(built, one.name)), said)
        for one in fields(built)
        if one.init
    ]


def _load(plugin: Plugin) -> Any:
    """Return the class or function of a plugin.

    Raises:
        KinfeasError: If it cannot be loaded, or is neither.
    """
    loaded = registry.load(plugin.group, plugin.name)
    if not callable(loaded):
        registry.build(plugin.group, plugin.name, {})  # which says so
    return loaded


def _parameter(name: str, kind: Any, default: str | None, said: Docstring) -> Parameter:
    description = said.entries.get(name, "")
    return Parameter(name, _type(kind), unit(description), default, description)


def _default(value: object, empty: object) -> str | None:
    return None if value is empty or value is MISSING else _text(value)


def _text(value: object) -> str:
    """Return a value as YAML would have it, shortened."""
    if value is None:
        return "null"
    if isinstance(value, bool):
        return str(value).lower()
    if is_dataclass(value) or isinstance(value, dict):
        return "..."
    if isinstance(value, tuple | list):
        lists = not any(is_dataclass(one) for one in value)
        return f"[{', '.join(map(_text, value))}]" if lists else f"{len(value)} of them"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _type(kind: Any) -> str:
    """Return a type as it is written, its bounds and modules left out."""
    if kind is inspect.Parameter.empty:
        return ""
    text = kind if isinstance(kind, str) else inspect.formatannotation(kind)
    return re.sub(r"\b(\w+\.)+(?=\w)", "", re.sub(r"Annotated\[(\w+), \w+\([^)]*\)\]", r"\1", text))


def _task(name: str, found: list[Parameter]) -> dict[str, Any]:
    """Return parameters and sub-goals of a task by name or path; its fields if none were found."""
    from kinfeas.tasks.loading import load_task

    task = load_task(name)
    found = found or fields_of(task)
    return {
        "subgoals": [_subgoal(subgoal) for subgoal in task.subgoals],
        "parameters": [vars(one) for one in found],
    }


def _subgoal(subgoal: Any) -> dict[str, Any]:
    return {
        "motion": subgoal.motion.generator,
        "parameters": subgoal.motion.parameters,
        "frame": subgoal.frame,
        "wait_s": subgoal.dwell,
        "grip": subgoal.grip,
        "place": getattr(subgoal, "place", None),
    }


def _robot(name: str) -> dict[str, Any]:
    robot = load_robot(name)
    joints = [
        {
            "name": joint.name,
            "unit": "m" if robot.urdf.joints[joint.name].kind == "prismatic" else "rad",
            "lower": None if joint.continuous else joint.lower,
            "upper": None if joint.continuous else joint.upper,
            "velocity": joint.velocity,
        }
        for joint in robot.arm
    ]
    return {
        "name": robot.name,
        "urdf": str(robot.urdf_path),
        "base": vars(robot.base),
        "arm": joints,
        "ee_frame": robot.ee_frame,
        "tool_tip_m": [round(value, 4) for value in robot.tool_tip.tolist()],
        "goal_heights_m": {key: list(value) for key, value in robot.goal_heights.items()},
        "pose_tolerance": None if robot.pose_tolerance is None else vars(robot.pose_tolerance),
        "gripper": None if robot.gripper is None else list(robot.gripper.fingers),
        "configurations": list(robot.home),
    }
