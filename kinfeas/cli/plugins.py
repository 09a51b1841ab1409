"""`kinfeas plugins`: what is installed, whether it is sound, and a start for one of your own."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import typer

from kinfeas.cli import inputs, options, plugin_check, plugin_new
from kinfeas.cli.commands import Command, Group
from kinfeas.cli.docstrings import unwrapped
from kinfeas.cli.examples import epilog
from kinfeas.cli.output import check_outputs, print_table, write_json

if TYPE_CHECKING:
    from rich.text import Text

    from kinfeas.core.registry import Plugin

app = typer.Typer(
    cls=Group,
    no_args_is_help=True,
    help="Robots, tasks, motion generators, adapters and backends: show, check and begin them.",
)


def list_plugins(json: options.JsonPath = None) -> None:
    """List what is installed and where it comes from; what is broken is shown with its error."""
    from kinfeas.cli.plugin_facts import summary
    from kinfeas.core.registry import GROUPS, plugins

    found = [(plugin, *summary(plugin)) for group in GROUPS for plugin in plugins(group)]
    if json is not None:
        entries = [
            {**vars(plugin), "kind": GROUPS[plugin.group], "description": text, "error": error}
            for plugin, text, error in found
        ]
        write_json(entries, json)
    for group, kind in GROUPS.items():
        _list(f"{kind}s", [one for one in found if one[0].group == group])


def _list(title: str, found: "list[tuple[Plugin, str, str | None]]") -> None:
    """Print a table of plugins of one kind; where they come from once, if it is one distribution.

    Args:
        title: What the kind is called.
        found: Plugins, what each of them is, and why it is broken, if it is.
    """
    origins = {_origin(plugin) for plugin, _, _ in found}
    several = len(origins) > 1
    rows: list[list[str | Text]] = [
        [plugin.name, *([_origin(plugin)] if several else []), error_or(text, error)]
        for plugin, text, error in found
    ]
    columns = ["name", *(["from"] if several else []), "what it is"]
    print_table(title if several else ", from ".join([title, *origins]), columns, rows)


def error_or(text: str, error: str | None) -> "Text":
    """Return a plugin's description, or in red what is wrong with it."""
    from rich.text import Text

    return Text(text) if error is None else Text(f"broken: {error}", "red")


def info(name: options.PluginName, json: options.JsonPath = None) -> None:
    """Show a plugin's parameters with units and defaults, a robot's joints, or a task's sub-goals.

    A robot and a task may also be the path of a YAML file.
    """
    from kinfeas.cli.plugin_facts import facts, facts_of_file, find
    from kinfeas.io.files import is_path

    check_outputs({"--json": json}, {"NAME": inputs.named(name)})
    found = [facts_of_file(name)] if is_path(name) else [facts(plugin) for plugin in find(name)]
    if json is not None:
        write_json(found, json)
    for one in found:
        _show(one)


def _show(known: dict[str, Any]) -> None:
    title = f"{known['kind']} {known['name']}, from"
    if "file" in known:
        typer.echo(f"{title} {known['file']}\n")
    else:
        typer.echo(f"{title} {known['distribution']} {known['version']}, {known['target']}\n")
        typer.echo(f"{known['text']}\n" if known["text"] else "It has no docstring.\n")
    if "robot" in known:
        _show_robot(known["robot"])
    if "parameters" in known:
        _show_parameters(known["parameters"])
    if "subgoals" in known:
        _show_subgoals(known["subgoals"])


def _show_parameters(parameters: list[dict[str, Any]]) -> None:
    if not parameters:
        typer.echo("It has no parameters.")
        return
    rows = [
        [
            one["name"],
            one["type"],
            one["unit"],
            "must be given" if one["default"] is None else one["default"],
            one["description"],
        ]
        for one in parameters
    ]
    print_table("parameters", ["name", "type", "unit", "default", "what it is"], rows)


def _show_subgoals(subgoals: list[dict[str, Any]]) -> None:
    rows = [
        [
            str(number),
            subgoal["motion"],
            " ".join(f"{key}={value}" for key, value in subgoal["parameters"].items()),
            subgoal["frame"],
            subgoal["place"] or "drawn at random",
            f"{subgoal['wait_s']:g} s",
            subgoal["grip"] or "",
        ]
        for number, subgoal in enumerate(subgoals, start=1)
    ]
    columns = [" sub-goal", "motion", "its parameters", "frame", "leads to", " wait", "grip"]
    print_table("subgoals", columns, rows)


def _show_robot(robot: dict[str, Any]) -> None:
    rows = [
        [
            joint["name"],
            "no limit" if joint["lower"] is None else f"{joint['lower']:.3g}",
            "no limit" if joint["upper"] is None else f"{joint['upper']:.3g}",
            joint["unit"],
            f"{joint['velocity']:.3g} {joint['unit']}/s",
        ]
        for joint in robot["arm"]
    ]
    print_table("arm", ["joint", " lower", " upper", "unit", " velocity"], rows)
    base = robot["base"]
    heights = (f"{name} {low:g} to {high:g} m" for name, (low, high) in _heights(robot))
    pose_tolerance = robot["pose_tolerance"]
    facts = [
        ["drive", base["drive"]],
        ["base velocity", f"{base['max_velocity']:g} m/s, {base['max_rotation']:g} rad/s"],
        [
            "base acceleration",
            f"{base['max_acceleration']:g} m/s^2, {base['max_rotation_acceleration']:g} rad/s^2",
        ],
        ["base frame", base["frame"]],
        ["EE frame", robot["ee_frame"]],
        ["tool tip in it", f"{', '.join(f'{value:g}' for value in robot['tool_tip_m'])} m"],
        ["goal heights", ", ".join(heights)],
        [
            "pose tolerance on the way",
            "none"
            if pose_tolerance is None
            else f"{pose_tolerance['position']:g} m, {pose_tolerance['rotation']:g} rad",
        ],
        ["gripper", ", ".join(robot["gripper"] or ["none"])],
        ["configurations", ", ".join(robot["configurations"])],
        ["URDF", robot["urdf"]],
    ]
    print_table(f"robot {robot['name']}", ["", ""], facts)


def _heights(robot: dict[str, Any]) -> list[tuple[str, tuple[float, float]]]:
    return [(name, (low, high)) for name, (low, high) in robot["goal_heights_m"].items()]


def _origin(plugin: "Plugin") -> str:
    return f"{plugin.distribution} {plugin.version}"


_COMMANDS: dict[str, Callable[..., None]] = {
    "list": list_plugins,
    "info": info,
    "new": plugin_new.new,
    "check": plugin_check.check,
}
for _name, _command in _COMMANDS.items():
    app.command(_name, cls=Command, help=unwrapped(_command), epilog=epilog(f"plugins {_name}"))(
        _command
    )
