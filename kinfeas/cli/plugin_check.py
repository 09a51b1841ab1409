"""`kinfeas plugins check`: whether a motion generator keeps its contract."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from kinfeas.cli import completion, inputs, options
from kinfeas.cli.output import (
    check_file_path,
    check_outputs,
    print_table,
    progress,
    say_written,
    status,
    write_json,
)
from kinfeas.core.errors import KinfeasError

if TYPE_CHECKING:
    from kinfeas.testing import Finding
    from kinfeas.testing.trial import Trial

_GROUP = "kinfeas.motion_generators"


def check(  # noqa: PLR0913, PLR0917 - each option is an argument
    name: Annotated[
        str,
        typer.Argument(
            help="Name of a motion generator.",
            autocompletion=completion.plugins("motion_generators"),
        ),
    ],
    overrides: options.Overrides = None,
    duration: Annotated[
        float, typer.Option("--duration", min=0.1, help="Seconds in which a motion must arrive.")
    ] = 120.0,
    dt: Annotated[float, typer.Option("--dt", min=0.001, help="Seconds of a step.")] = 0.1,
    max_velocity: Annotated[
        float, typer.Option("--max-velocity", min=0.0, help="Speed that it must keep to, m/s.")
    ] = 0.1,
    max_angular_velocity: Annotated[
        float,
        typer.Option("--max-angular-velocity", min=0.0, help="The same of the turning, rad/s."),
    ] = 0.1,
    seed: options.Seed = 0,
    picture: Annotated[
        Path | None,
        typer.Option(
            "--picture", help="Draw sample motions into this PNG.", callback=check_file_path
        ),
    ] = None,
    json: options.JsonPath = None,
) -> None:
    """Put a motion generator to the conformance test that the built-in ones pass.

    Settings: the generator's own parameters, such as [bold]gain=0.2[/]. It ends with exit code 2
    if a rule is broken.
    """
    from kinfeas.config import assigned
    from kinfeas.testing.trial import Trial

    check_outputs({"--picture": picture, "--json": json}, {"--set": inputs.of_settings(overrides)})
    parameters = assigned(overrides or [])
    trial = Trial(None, seed, duration, dt, max_velocity, max_angular_velocity)
    findings = _examine(name, parameters, trial)
    if json is not None:
        write_json(_plain(name, parameters, findings), json)
    _show(name, findings)
    if picture is not None:
        _draw(name, parameters, trial, picture)
    say_written(picture)
    _judge(name, findings)


def _examine(name: str, parameters: dict[str, object], trial: "Trial") -> list["Finding"]:
    from kinfeas.core import registry
    from kinfeas.core.registry import MissingParameterError
    from kinfeas.testing import examine

    try:
        generator = registry.build(_GROUP, name, parameters)
    except KinfeasError as error:
        if not isinstance(missing := error.__cause__, MissingParameterError):
            raise
        raise KinfeasError(f"{error}: --set {missing.parameter}=VALUE") from error
    with progress(f"checking {name}", trial.steps) as advance:
        return examine(generator, trial, name, lambda: advance(1.0))


def _draw(name: str, parameters: dict[str, object], trial: "Trial", path: Path) -> None:
    from kinfeas.core import registry
    from kinfeas.core.checked_motion import CheckedMotion
    from kinfeas.io.files import write_file
    from kinfeas.testing.trial import sample_motions
    from kinfeas.viz.plots import motion_figure
    from kinfeas.viz.style import png

    motion = CheckedMotion(registry.build(_GROUP, name, parameters), name, every_step=True)
    with status("drawing"):
        figure = motion_figure(name, sample_motions(motion, trial), trial)
        write_file(path, png(figure, dpi=110))


def _plain(
    name: str, parameters: dict[str, object], findings: list["Finding"]
) -> dict[str, object]:
    from kinfeas.testing import RULES

    rules = [
        {"rule": one.rule, "text": RULES[one.rule], "result": _result(one), "broken": one.broken}
        for one in findings
    ]
    passed = all(one.kept for one in findings)
    return {"generator": name, "parameters": parameters, "passed": passed, "rules": rules}


def _result(one: "Finding") -> str:
    if one.broken is not None:
        return "broken"
    return "kept" if one.checked else "not checked"


def _show(name: str, findings: list["Finding"]) -> None:
    from rich.text import Text

    from kinfeas.testing import RULES

    colours = {"kept": "green", "broken": "red", "not checked": "yellow"}
    rows: list[list[str | Text]] = [
        [RULES[one.rule], Text(_result(one), colours[_result(one)]), one.broken or ""]
        for one in findings
    ]
    print_table(f"motion generator {name}", ["rule", "", "how"], rows)


def _judge(name: str, findings: list["Finding"]) -> None:
    """Say that all is well.

    Raises:
        KinfeasError: If a rule is broken.
    """
    broken = [one.broken for one in findings if one.broken is not None]
    if broken:
        count = f"{len(broken)} of {len(findings)} rules broken"
        raise KinfeasError(f"{count}: {broken[0]}")
    typer.echo(f"motion generator {name} passes: all {len(findings)} rules are kept")
