"""`kinfeas plugins`: installed plugins, their conformance, and templates of new ones."""

import inspect
import re
import shlex
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from kinfeas.cli import options
from kinfeas.cli.options import argument, option
from kinfeas.cli.output import print_facts, print_table, progress, write_drawing, write_json
from kinfeas.core import registry
from kinfeas.core.errors import KinfeasError, no_such, plugin_note
from kinfeas.core.registry import GROUPS, Plugin
from kinfeas.io.files import is_path
from kinfeas.templates import Kind

if TYPE_CHECKING:
    from kinfeas.testing import Finding
    from kinfeas.testing.rules import Trial

app = typer.Typer(no_args_is_help=True, help="List, check and create plugins.")

_GENERATORS = "kinfeas.motion_generators"
_GIVEN = {
    "kinfeas.adapters": ("backend", "robot"),
    "kinfeas.backends": ("robot",),
    "kinfeas.policies": ("robot",),
}
"""Parameters that the program itself passes."""


@app.command("list")
def list_plugins(json: options.JsonPath = None) -> None:
    """List installed plugins, broken ones with their error.

    Example: kinfeas plugins list
    """
    from rich.text import Text

    listed = []
    for group, kind in GROUPS.items():
        rows: list[list[str | Text]] = []
        for plugin in registry.plugins(group):
            text, error = _summary(plugin)
            listed.append({**vars(plugin), "kind": kind, "description": text, "error": error})
            line = Text(text) if error is None else Text(f"broken: {error}", "red")
            rows.append([plugin.name, f"{plugin.distribution} {plugin.version}", line])
        print_table(f"{kind}s".replace("ys", "ies"), ["name", "from", "description"], rows)
    write_json(listed, json)


@app.command()
def info(
    name: Annotated[
        str,
        argument(
            "Name of a plugin, folder of a robot, or YAML file of a task.",
            groups=[group.removeprefix("kinfeas.") for group in GROUPS],
        ),
    ],
    json: options.JsonPath = None,
) -> None:
    """Show documentation and parameters of a plugin.

    Robots are shown with their joints, tasks with their sub-goals.

    Example: kinfeas plugins info linear
    """
    plugins = (
        [_facts_of_file(name)] if is_path(name) else [_facts(plugin) for plugin in _find(name)]
    )
    write_json(plugins, json)
    for facts in plugins:
        origin = facts.get("file") or "{distribution} {version}, {target}".format(**facts)
        title = f"{facts['kind']} {facts['name']}, from {origin}\n\n{facts.get('text', '')}".strip()
        keys = ("robot", "parameters", "subgoals")
        print_facts(title, {key: facts[key] for key in keys if key in facts})


@app.command()
def new(
    name: Annotated[str, argument("Name of the plugin, such as my_motion.")],
    out: Annotated[Path | None, option("Folder.  [default: ./kinfeas-NAME]")] = None,
    kind: Annotated[
        Kind, option(f"Kind of plugin: {', '.join(Kind)}.", metavar="KIND")
    ] = Kind.MOTION_GENERATOR,
) -> None:
    """Create a plugin distribution with example, test and README.

    Example: kinfeas plugins new porter --kind robot --out porter
    """
    from kinfeas.templates.distribution import write_distribution

    folder = out or Path(f"kinfeas-{name.replace('_', '-')}")
    for path in write_distribution(kind, name, folder):
        typer.echo(str(path))
    quoted = shlex.quote(str(folder))
    typer.echo(f"install it: pip install -e {quoted}\ntest it: pytest {quoted}")


@app.command()
def check(  # noqa: PLR0913, PLR0917 - each option is an argument
    name: Annotated[
        str,
        argument(
            "Name of a motion generator or policy, or module:Class of a policy.",
            groups=("motion_generators", "policies"),
        ),
    ],
    overrides: options.Overrides = None,
    duration: Annotated[float, option("Seconds within which motions arrive.", min=0.1)] = 120.0,
    dt: Annotated[float, option("Seconds of a step.", min=0.001)] = 0.1,
    max_velocity: Annotated[float, option("Speed limit, m/s.", min=0.0)] = 0.1,
    max_angular_velocity: Annotated[float, option("The same in rad/s.", min=0.0)] = 0.1,
    seed: options.Seed = 0,
    robot: Annotated[str | None, option("Robot of a policy; policies need one.")] = None,
    picture: options.Picture = None,
    json: options.JsonPath = None,
) -> None:
    """Check a motion generator or a policy. The exit code is 2 if a rule is broken.

    Settings: the generator's parameters, such as gain=0.2.

    Example: kinfeas plugins check minimum_jerk --set min_duration=2 --picture motions.png
    """
    from kinfeas.config import nested
    from kinfeas.testing import RULES, examine
    from kinfeas.testing.rules import Trial

    if name in registry.names("kinfeas.policies") or ":" in name:
        if overrides or picture is not None:
            raise KinfeasError(f"policy {name!r} has no settings and no picture")
        if robot is None:
            robots = ", ".join(registry.names("kinfeas.robots"))
            raise KinfeasError(f"policy {name!r} needs --robot: {robots}, or a YAML file")
        _check_policy(name, robot)
        write_json({"policy": name, "robot": robot, "passed": True}, json)
        return
    parameters = nested(options.read_settings(overrides))
    trial = Trial(seed, duration, dt, max_velocity, max_angular_velocity)
    generator = registry.build(_GENERATORS, name, parameters)
    with progress(f"checking {name}", trial.steps) as advance:
        findings = examine(generator, trial, name, lambda: advance(1.0))
    rows = [[RULES[finding.rule], _result(finding), finding.broken or ""] for finding in findings]
    rules = [
        {"rule": finding.rule, "text": text, "result": result, "broken": finding.broken}
        for finding, (text, result, _) in zip(findings, rows, strict=True)
    ]
    broken = [finding.broken for finding in findings if finding.broken is not None]
    passed = all(finding.kept for finding in findings)
    report = {"generator": name, "parameters": parameters, "passed": passed, "rules": rules}
    write_json(report, json)
    print_table(f"motion generator {name}", ["rule", "", "error"], rows)
    if all(finding.checked for finding in findings):  # a severe violation ends the motions
        write_drawing(lambda: _drawing(name, parameters, trial), picture)
    if broken:
        raise KinfeasError(f"{len(broken)} of {len(findings)} rules broken: {broken[0]}")
    typer.echo(f"motion generator {name} passes all {len(findings)} rules")


def _check_policy(name: str, robot: str) -> None:
    from kinfeas.policies.loading import load_policy
    from kinfeas.robots.loading import load_robot
    from kinfeas.testing import check_policy

    model = load_robot(robot)
    check_policy(load_policy(name, model), model)
    typer.echo(f"policy {name} keeps the contract on robot {model.name}")


def _result(finding: "Finding") -> str:
    if finding.broken is not None:
        return "broken"
    return "kept" if finding.checked else "not checked"


def _drawing(name: str, parameters: dict[str, object], trial: "Trial") -> bytes:
    from kinfeas.core.checks import CheckedMotion
    from kinfeas.testing.rules import sample_motions
    from kinfeas.viz.plots import motion_figure
    from kinfeas.viz.style import png

    generator = registry.build(_GENERATORS, name, parameters)
    motions = sample_motions(CheckedMotion(generator, name, every_step=True), trial)
    return png(motion_figure(name, motions, trial), dpi=110)


def _summary(plugin: Plugin) -> tuple[str, str | None]:
    """Return a line on a plugin, and its error if it is broken."""
    from kinfeas.robots.loading import load_robot

    try:
        if plugin.group == "kinfeas.robots":
            robot = load_robot(plugin.name)
            return f"{robot.base.drive} base, arm of {len(robot.arm)} joints", None
        return _documentation(_load(plugin)).partition("\n")[0], None
    except KinfeasError as error:
        return "", " ".join(str(error).split())


def _find(name: str) -> list[Plugin]:
    every = [plugin for group in GROUPS for plugin in registry.plugins(group)]
    plugins = [plugin for plugin in every if plugin.name == name]
    if not plugins:
        raise KinfeasError(
            f"unknown plugin {name!r}{no_such(name, {plugin.name for plugin in every})}"
        )
    return plugins


def _load(plugin: Plugin) -> Any:
    loaded = registry.load(plugin.group, plugin.name)
    if not callable(loaded):
        registry.build(plugin.group, plugin.name, {})  # raises the error
    return loaded


def _documentation(factory: Any) -> str:
    """Return the docstring of a function, or of a class and its constructor."""
    own = [factory.__doc__]
    if isinstance(factory, type) and factory.__init__ is not object.__init__:  # type: ignore[misc]
        own.append(factory.__init__.__doc__)  # type: ignore[misc]
    return "\n\n".join(inspect.cleandoc(text) for text in own if text)


def _facts(plugin: Plugin) -> dict[str, Any]:
    factory = _load(plugin)
    facts = {**vars(plugin), "kind": GROUPS[plugin.group], "text": _documentation(factory)}
    if plugin.group == "kinfeas.robots":
        return facts | {"robot": _robot_facts(plugin.name)}
    with plugin_note(str(plugin)):
        parameters = [
            _parameter(parameter.name, parameter.annotation, parameter.default)
            for parameter in inspect.signature(factory).parameters.values()
            if parameter.kind in (parameter.POSITIONAL_OR_KEYWORD, parameter.KEYWORD_ONLY)
            and parameter.name not in _GIVEN.get(plugin.group, ())
        ]
    if plugin.group == "kinfeas.tasks" and all("default" in parameter for parameter in parameters):
        facts |= _task_facts(plugin.name)
    return facts | ({"parameters": parameters} if parameters or "parameters" not in facts else {})


def _facts_of_file(path: str) -> dict[str, Any]:
    from kinfeas.config import strict_yaml
    from kinfeas.robots.loading import check_no_urdf

    check_no_urdf(path)
    if not Path(path).is_dir() and "subgoals" in strict_yaml.read(Path(path)):
        return {"kind": "task", "name": Path(path).stem, "file": path, **_task_facts(path)}
    robot = _robot_facts(path)
    return {"kind": "robot", "name": robot["name"], "file": path, "robot": robot}


def _parameter(name: str, kind: Any, default: object) -> dict[str, Any]:
    """Return name, type and default of a parameter; required ones have no default."""
    from pydantic_core import to_jsonable_python

    text = kind if isinstance(kind, str) else inspect.formatannotation(kind)
    text = re.sub(r"Annotated\[(\w+), \w+\([^)]*\)\]", r"\1", text)
    facts = {"name": name, "type": re.sub(r"\b(\w+\.)+(?=\w)", "", text)}
    if default is inspect.Parameter.empty:
        return facts
    return {**facts, "default": to_jsonable_python(default, fallback=str)}


def _task_facts(name: str) -> dict[str, Any]:
    from pydantic_core import to_jsonable_python

    from kinfeas.tasks.loading import load_task

    task: Any = load_task(name)
    own = [entry for entry in fields(task) if entry.init] if is_dataclass(task) else []
    parameters = [_parameter(entry.name, entry.type, getattr(task, entry.name)) for entry in own]
    return {"subgoals": to_jsonable_python(task.subgoals), "parameters": parameters}


def _robot_facts(name: str) -> dict[str, Any]:
    from kinfeas.robots.loading import load_robot

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
        "reach_m": [robot.reach.low, robot.reach.high],
        "pose_tolerance": None if robot.pose_tolerance is None else vars(robot.pose_tolerance),
        "gripper": None if robot.gripper is None else list(robot.gripper.fingers),
        "configurations": list(robot.home),
    }
