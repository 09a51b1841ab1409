"""`kinfeas plugins`: what is installed, whether it is sound, and a start for one of your own."""

from typing import TYPE_CHECKING, Any

import typer

from kinfeas.cli import options, plugin_check, plugin_new
from kinfeas.cli.examples import epilog
from kinfeas.cli.output import print_table, write_json

if TYPE_CHECKING:
    from rich.text import Text

    from kinfeas.registry import Plugin

app = typer.Typer(
    no_args_is_help=True,
    help="Robots, tasks, motion generators, adapters and backends: show, check and begin them.",
)


@app.command("list", epilog=epilog("plugins list"))
def list_plugins(json: options.JsonPath = None) -> None:
    """List what is installed and where it comes from; what is broken is shown with its error."""
    from kinfeas.cli.plugin_facts import summary
    from kinfeas.registry import GROUPS, plugins

    found = [(plugin, *summary(plugin)) for group in GROUPS for plugin in plugins(group)]
    if json is not None:
        entries = [
            {**vars(plugin), "kind": GROUPS[plugin.group], "description": text, "error": error}
            for plugin, text, error in found
        ]
        write_json(entries, json)
    rows: list[list[str | Text]] = [
        [GROUPS[plugin.group], plugin.name, _origin(plugin), error_or(text, error)]
        for plugin, text, error in found
    ]
    print_table("plugins", ["kind", "name", "from", "what it is"], rows)


def error_or(text: str, error: str | None) -> "Text":
    """Return a plugin's description, or in red what is wrong with it."""
    from rich.text import Text

    return Text(text) if error is None else Text(f"broken: {error}", "red")


@app.command("info", epilog=epilog("plugins info"))
def info(name: options.PluginName, json: options.JsonPath = None) -> None:
    """Show a plugin's parameters with units and defaults, a robot's joints, or a task's legs."""
    from kinfeas.cli.plugin_facts import facts, find

    found = [facts(plugin) for plugin in find(name)]
    if json is not None:
        write_json(found, json)
    for one in found:
        _show(one)


app.command("new", epilog=epilog("plugins new"))(plugin_new.new)
app.command("check", epilog=epilog("plugins check"))(plugin_check.check)


def _show(known: dict[str, Any]) -> None:
    origin = f"{known['distribution']} {known['version']}"
    typer.echo(f"{known['kind']} {known['name']}, from {origin}, {known['target']}\n")
    typer.echo(f"{known['text']}\n" if known["text"] else "It has no docstring.\n")
    if "robot" in known:
        _show_robot(known["robot"])
    if "parameters" in known:
        _show_parameters(known["parameters"])
    if "legs" in known:
        _show_legs(known["legs"])


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


def _show_legs(legs: list[dict[str, Any]]) -> None:
    rows = [
        [
            str(number),
            leg["motion"],
            " ".join(f"{key}={value}" for key, value in leg["parameters"].items()),
            leg["frame"],
            leg["place"] or "drawn at random",
            f"{leg['wait_s']:g} s",
            leg["grip"] or "",
        ]
        for number, leg in enumerate(legs, start=1)
    ]
    columns = [" leg", "motion", "its parameters", "frame", "leads to", " wait", "grip"]
    print_table("legs", columns, rows)


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
    leeway = robot["leeway"]
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
            "leeway on the way",
            "none" if leeway is None else f"{leeway['position']:g} m, {leeway['rotation']:g} rad",
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
