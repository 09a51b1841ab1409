"""`kinfeas plugins`: installed plugins, their conformance, and templates of new ones."""

import inspect
import re
import shlex
from dataclasses import fields, is_dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from kinfeas.cli import options
from kinfeas.cli.options import argument, option
from kinfeas.cli.output import print_facts, print_table, progress, write_drawing, write_json
from kinfeas.config import registry
from kinfeas.config.registry import GROUPS, Plugin
from kinfeas.core.errors import PLUGIN_ERRORS, KinfeasError, describe, no_such, plugin_note
from kinfeas.core.files import is_path
from kinfeas.templates import Kind, write_distribution

if TYPE_CHECKING:
    from kinfeas.config import PluginSpec
    from kinfeas.testing.rules import Trial

app = typer.Typer(no_args_is_help=True, help="List, check and create plugins.")

_KINDS = f"Kind of plugin: {', '.join(Kind)}."
_GENERATORS = "kinfeas.motion_generators"
_CHECKED = (
    "kinfeas.policies", "kinfeas.adapters", "kinfeas.filters", "kinfeas.backends", _GENERATORS,
)  # fmt: skip
"""Groups that `check` covers; if several have a plugin of the name, the first group counts."""
_PASSED = {
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
    listed = []
    for group, kind in GROUPS.items():
        rows = []
        for plugin in registry.plugins(group):
            text, error = _summary(plugin)
            listed.append({**vars(plugin), "kind": kind, "description": text, "error": error})
            origin = f"{plugin.distribution} {plugin.version}"
            rows.append([plugin.name, origin, text if error is None else f"not usable: {error}"])
        print_table(f"{kind}s".replace("ys", "ies"), ["name", "from", "description"], rows)
    write_json(listed, json)


@app.command()
def info(
    name: str = argument(..., "Name of a plugin, YAML file of a task, or folder of a robot."),
    json: options.JsonPath = None,
) -> None:
    """Show documentation and parameters of a plugin.

    Robots are shown with their joints, tasks with their sub-goals. Files are checked.

    Example: kinfeas plugins info linear
    """
    if is_path(name):
        facts = _facts_of_file(name)
        write_json([facts], json)
        print_facts("{kind} {name}".format(**facts), facts)
        return
    installed = [plugin for group in GROUPS for plugin in registry.plugins(group)]
    plugins = [_facts(plugin) for plugin in installed if plugin.name == name]
    if not plugins:
        near = get_close_matches(name, {plugin.name for plugin in installed})
        guess = f" (did you mean {' or '.join(map(repr, near))}?)" if near else ""
        hint = "`kinfeas plugins list` lists the installed ones, `pip install -e FOLDER` adds one"
        raise KinfeasError(f"unknown plugin {name!r}{guess}; {hint}")
    write_json(plugins, json)
    for facts in plugins:
        title = "{kind} {name}, from {distribution} {version}, {target}\n\n{text}".format(**facts)
        keys = ("robot", "parameters", "subgoals")
        print_facts(title, {key: facts[key] for key in keys if key in facts})


@app.command()
def new(
    name: str = argument(..., "Name of the plugin, such as my_motion."),
    out: Path | None = option(None, "Folder.  [default: ./kinfeas-NAME]"),
    kind: Kind = option(Kind.MOTION_GENERATOR, _KINDS, metavar="KIND"),
) -> None:
    """Create a plugin distribution with example, test and README.

    Example: kinfeas plugins new porter --kind robot --out porter
    """
    folder = out or Path(f"kinfeas-{name.replace('_', '-')}")
    for path in write_distribution(kind, name, folder):
        typer.echo(str(path))
    quoted = shlex.quote(str(folder))
    typer.echo(f"install it: pip install --no-deps -e {quoted}")
    typer.echo(f"test it (pip install pytest): pytest {quoted}")


@app.command()
def check(  # noqa: PLR0913, PLR0917 - each option is an argument
    name: str = argument(
        ..., "Plugin; or module:Class of a motion generator, with --robot of a policy."
    ),
    overrides: options.Overrides = None,
    duration: float = option(120.0, "Seconds within which motions arrive.", min=0.1),
    dt: float = option(0.1, "Seconds of a step.", min=0.001),
    max_velocity: float = option(0.1, "Speed limit, m/s.", min=0.0),
    max_angular_velocity: float = option(0.1, "The same in rad/s.", min=0.0),
    seed: options.Seed = 0,
    robot: str | None = option(None, "Robot of other plugins; policies need one."),
    world: str = option("analytic", "Backend of filters and adapters."),
    picture: options.Picture = None,
    json: options.JsonPath = None,
) -> None:
    """Check whether a plugin keeps its contract. The exit code is 2 if a rule is broken.

    Motion generators, policies, adapters, command filters and simulators.

    Settings: parameters of the plugin, such as gain=0.2.

    Example: kinfeas plugins check minimum_jerk --set min_duration=2 --picture motions.png
    """
    from kinfeas.api import DEFAULT_ROBOT
    from kinfeas.config import PluginSpec, nested
    from kinfeas.testing import Trial

    group, parameters = _checked_group(name, robot), nested(options.read_settings(overrides))
    if group == _GENERATORS:
        trial = Trial(seed, duration, dt, max_velocity, max_angular_velocity)
        _check_generator(name, parameters, trial, picture, json)
        return
    if picture is not None:
        raise KinfeasError(f"{GROUPS[group]} {name!r} has no picture")
    if group == "kinfeas.policies":
        if overrides:
            raise KinfeasError(f"policy {name!r} has no settings")
        if robot is None:
            robots = ", ".join(registry.names("kinfeas.robots"))
            raise KinfeasError(f"policy {name!r} needs --robot: {robots}, or a folder")
    _check_on_robot(group, PluginSpec(name, parameters), robot or DEFAULT_ROBOT, world, json)


def _checked_group(name: str, robot: str | None) -> str:
    """Return the group of a plugin that `check` covers."""
    if ":" in name:
        return _GENERATORS if robot is None else "kinfeas.policies"
    names = {group: registry.names(group) for group in (*_CHECKED, *GROUPS)}
    for group, installed in names.items():
        if name in installed:
            if group in _CHECKED:
                return group
            covered = ", ".join(GROUPS[each] for each in _CHECKED)
            raise KinfeasError(f"{name!r} is a {GROUPS[group]}; check covers: {covered}")
    known = [each for group in _CHECKED for each in names[group]]
    raise KinfeasError(f"no plugin {name!r} that check covers{no_such(name, known)}")


def _check_on_robot(
    group: str, plugin: "PluginSpec", robot: str, world: str, json: Path | None
) -> None:
    from kinfeas import testing
    from kinfeas.policies.loading import load_policy
    from kinfeas.robots.loading import load_robot

    model, kind = load_robot(robot), GROUPS[group]
    facts = {kind.removeprefix("command "): plugin.name, "robot": robot}
    if group == "kinfeas.policies":
        testing.check_policy(load_policy(plugin.name, model), model)
    elif group == "kinfeas.backends":
        testing.check_backend(plugin, model)
    else:
        adapts = group == "kinfeas.adapters"
        (testing.check_adapter if adapts else testing.check_filter)(plugin, model, world)
        facts["world"] = world
    write_json({**facts, "passed": True}, json)
    typer.echo(f"{kind} {plugin.name} keeps the contract on robot {model.name}")


def _check_generator(
    name: str, parameters: dict[str, object], trial: "Trial", picture: Path | None,
    json: Path | None,
) -> None:  # fmt: skip
    from kinfeas.api import counter
    from kinfeas.testing import RULES, examine

    generator = registry.build(_GENERATORS, name, parameters)
    with progress() as on_progress:
        findings = examine(
            generator, trial, name, counter(on_progress, f"checking {name}", trial.steps)
        )
    rules = [finding.facts() for finding in findings]
    passed = all(finding.kept for finding in findings)
    report = {"generator": name, "parameters": parameters, "passed": passed, "rules": rules}
    write_json(report, json)
    rows = [
        [RULES[found.rule], found.broken or ("kept" if found.checked else "not checked")]
        for found in findings
    ]
    print_table(f"motion generator {name}", ["rule", "result"], rows)
    if all(finding.checked for finding in findings):  # a severe violation ends the motions
        write_drawing(lambda: _drawing(name, parameters, trial), picture)
    if broken := [finding.broken for finding in findings if finding.broken is not None]:
        raise KinfeasError(f"{len(broken)} of {len(findings)} rules broken: {broken[0]}")
    typer.echo(f"motion generator {name} passes all {len(findings)} rules")


def _drawing(name: str, parameters: dict[str, object], trial: "Trial") -> bytes:
    from kinfeas.core.checks import CheckedMotion
    from kinfeas.testing.rules import sample_motions
    from kinfeas.viz.plots import motion_figure
    from kinfeas.viz.style import png

    generator = registry.build(_GENERATORS, name, parameters)
    motions = sample_motions(CheckedMotion(generator, name, every_step=True), trial)
    return png(motion_figure(name, motions, trial), dpi=110)


def _summary(plugin: Plugin) -> tuple[str, str | None]:
    """Return the first line of a plugin's documentation, and its error if it is broken."""
    from kinfeas.robots.loading import load_robot

    if registry.is_ignored(plugin):
        return "", "kinfeas has one of this name, which is used"
    try:
        if plugin.group == "kinfeas.robots":
            load_robot(plugin.name)
        return _documentation(registry.load(plugin.group, plugin.name)).partition("\n")[0], None
    except KinfeasError as error:
        text = str(error)
    except PLUGIN_ERRORS as error:
        text = describe(error)
    return "", " ".join(text.split())


def _documentation(factory: Any) -> str:
    """Return the docstring of a function, or of a class and its constructor."""
    own = [factory.__doc__]
    if isinstance(factory, type):
        own.append(factory.__init__.__doc__)  # type: ignore[misc]
    inherited = object.__init__.__doc__
    return "\n\n".join(inspect.cleandoc(text) for text in own if text and text != inherited)


def _facts(plugin: Plugin) -> dict[str, Any]:
    factory = registry.load(plugin.group, plugin.name)
    facts = {**vars(plugin), "kind": GROUPS[plugin.group], "text": _documentation(factory)}
    if plugin.group == "kinfeas.robots":
        return facts | {"robot": _robot_facts(plugin.name)}
    with plugin_note(str(plugin)):
        parameters = [
            _parameter(parameter.name, parameter.annotation, parameter.default)
            for parameter in inspect.signature(factory).parameters.values()
            if parameter.kind in (parameter.POSITIONAL_OR_KEYWORD, parameter.KEYWORD_ONLY)
            and parameter.name not in _PASSED.get(plugin.group, ())
        ]
    if plugin.group == "kinfeas.tasks" and all("default" in parameter for parameter in parameters):
        facts |= _task_facts(plugin.name)
    return {"parameters": [], **facts, **({"parameters": parameters} if parameters else {})}


def _facts_of_file(name: str) -> dict[str, Any]:
    """Return the facts of a robot's folder, or of a task's file after building its motions."""
    from kinfeas.tasks.loading import load_task
    from kinfeas.tasks.task import build_subgoals

    if Path(name).is_dir():
        return {"kind": "robot", "name": name, "robot": _robot_facts(name)}
    build_subgoals(load_task(name).subgoals)
    return {"kind": "task", "name": name, **_task_facts(name)}


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
    from pydantic_core import to_jsonable_python

    from kinfeas.robots.loading import load_robot

    robot = load_robot(name)
    keys = (
        "name", "urdf_path", "base", "arm", "ee_frame", "tool_tip", "reach",
        "pose_tolerance", "gripper", "home",
    )  # fmt: skip
    return to_jsonable_python(
        {key: getattr(robot, key) for key in keys},
        inf_nan_mode="null",
        fallback=lambda array: array.tolist(),
    )
