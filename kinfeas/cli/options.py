"""Options that several commands share, and functions that read their values."""

import os
import sys
from collections.abc import Sequence
from contextlib import redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from kinfeas.cli.output import STDOUT, progress
from kinfeas.config import strict_yaml
from kinfeas.core.errors import KinfeasError
from kinfeas.core.extras import require
from kinfeas.core.files import check_file_path
from kinfeas.core.quantities import LAST_SEED, MOST_EPISODES, MOST_PROCESSES

if TYPE_CHECKING:
    from kinfeas.config import Settings
    from kinfeas.jobs.job import Job, Result

_WRITERS = {
    ".png": ("matplotlib",), ".gif": ("PIL", "pybullet"), ".mp4": ("av", "pybullet"),
    ".html": ("viser",), ".htm": ("viser",), ".onnx": ("onnx",),
}  # fmt: skip
"""Optional packages that write files, by suffix."""


def option(default: object, text: str, *names: str, **more: Any) -> Any:
    """Return an option with a help text, required if the default is `...`."""
    return typer.Option(default, *names, help=text, **more)


def argument(default: object, text: str, **more: Any) -> Any:
    """Return a positional argument with a help text, required if the default is `...`."""
    return typer.Argument(default, help=text, **more)


def file_option(default: object, text: str, *suffixes: str) -> Any:
    """Return an option for a file to write that ends in one of the suffixes."""

    def check(path: Path | None) -> Path | None:
        if path is not None:
            if path.suffix.lower() not in suffixes:
                raise KinfeasError(f"{path}: must end in {' or '.join(suffixes)}")
            require(*_WRITERS.get(path.suffix.lower(), ()))
        return check_file_path(path)

    return option(default, text, metavar=f"FILE{suffixes[0]}", callback=check)


def _read_json_path(context: typer.Context, path: Path | None) -> Path | None:
    """Return the path of the JSON; if it is standard output, tables go to standard error."""
    if path not in (STDOUT, Path("/dev/stdout")):
        return check_file_path(path)
    context.with_resource(redirect_stdout(sys.stderr))
    return STDOUT


ROBOT = "Robot: pr2, tiago, another of `plugins list`, or a folder."
TASK = "Task: ggr, pick_place, door, drawer, another of `plugins list`, or a YAML file."
_POLICIES = "Run folder, ONNX file, module:Class, or a name such as pretrained."
RobotName = Annotated[str, option(..., ROBOT)]
PolicyRobotName = Annotated[str | None, option(..., f"{ROBOT}  [default: that of the policy]")]
TaskName = Annotated[str, option(..., TASK)]
PolicyName = Annotated[str, option(..., _POLICIES)]
PolicyArgument = Annotated[str, argument(..., _POLICIES)]
OptionalPolicy = Annotated[str | None, argument(..., _POLICIES)]
World = Annotated[str, option(..., "Backend: analytic, pybullet, mujoco, or a plugin.")]
Episodes = Annotated[int, option(..., "Number of episodes.", min=1, max=MOST_EPISODES)]
Seed = Annotated[int, option(..., "Random seed.", min=0, max=LAST_SEED)]
Processes = Annotated[int, option(..., "Parallel processes.", min=1, max=MOST_PROCESSES)]
AllProcesses = Annotated[int | None, option(..., "Jobs at a time.  [default: all cores]", min=1)]
EngineName = Annotated[Literal["local", "ray"], option(..., "Where jobs run.")]
EngineAddress = Annotated[str | None, option(..., "Running Ray cluster, such as auto.")]
RobotBackend = Annotated[
    str | None,
    option(
        ...,
        "analytic, pybullet, mujoco, ros2, ros1, or a plugin.  "
        "[default: pybullet or, without it, mujoco]",
    ),
]
Rate = Annotated[float, option(..., "Control rate, Hz.", min=1.0, max=1000.0)]
Record = Annotated[Path | None, option(..., "New file.  [default: in runs/deploy]", metavar="CSV")]
GuardsFile = Annotated[
    Path | None, option(..., "Limits of guards.", "--guards", metavar="FILE.yaml")
]
AdapterList = Annotated[str | None, option(..., "paper, pr2_like, harsh, randomised, or a file.")]
Filters = Annotated[
    str | None, option(..., "Command filters with commas, or none.  [default: the robot's]")
]
Overrides = Annotated[
    list[str] | None,
    option(..., "Change a setting; may be repeated.", "--set", metavar="KEY=VALUE"),
]
JsonPath = Annotated[
    Path | None,
    option(..., "JSON of results; - is standard output.", metavar="FILE", callback=_read_json_path),
]
Picture = Annotated[Path | None, file_option(..., "Draw a picture.", ".png")]
Video = Annotated[
    Path | None,
    file_option(..., "Episode as .gif or .mp4, or four frames as .png.", ".gif", ".mp4", ".png"),
]


def read_settings(
    assignments: Sequence[str] | None, options: "Settings | None" = None
) -> dict[str, object]:
    """Return the settings of `options` that are not None, overridden by `KEY=VALUE` texts.

    VALUE is YAML.
    """
    settings = {key: value for key, value in (options or {}).items() if value is not None}
    for text in assignments or ():
        key, equals, value = text.partition("=")
        if not equals or not all(key.strip().split(".")):
            raise KinfeasError(f"{text}: must have the form key=value or key.inner=value")
        settings.pop(key.strip(), None)  # moves the key to the end, since later ones override
        settings[key.strip()] = strict_yaml.parse(value, text)
    return settings


def run_jobs(
    jobs: "Sequence[Job]", kind: str, engine: str, processes: int | None, address: str | None
) -> "list[Result]":
    """Return the results of jobs on an engine, with a progress bar."""
    from kinfeas.api import counter
    from kinfeas.jobs.job import build_engine
    from kinfeas.jobs.job import run_jobs as run

    paths = {job.path for job in jobs}
    missing = sum(not path.exists() for path in paths)
    text = f"{missing} {kind} to do ({len(paths) - missing} kept)"
    runner = build_engine(engine, processes or os.cpu_count() or 1, address)
    with progress() as on_progress:
        return run(jobs, runner, counter(on_progress, text, missing))
