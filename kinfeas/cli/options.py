"""Options that several commands share, and readers of their values."""

import json
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import redirect_stdout
from importlib.metadata import entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from kinfeas.cli.output import STDOUT, check_file_path, check_suffix
from kinfeas.config.quantities import LAST_SEED, MOST_EPISODES, MOST_PROCESSES
from kinfeas.core import registry
from kinfeas.core.errors import KinfeasError
from kinfeas.core.extras import require
from kinfeas.io.files import is_path

if TYPE_CHECKING:
    from kinfeas.config import PluginSpec
    from kinfeas.jobs.job import Engine
    from kinfeas.robots.robot import Robot
    from kinfeas.tasks.task import Task

DEFAULT_ROBOT = "pr2"

_WRITERS = {
    ".png": ("matplotlib",), ".gif": ("PIL", "pybullet"), ".mp4": ("av", "pybullet"),
    ".html": ("viser",), ".htm": ("viser",), ".onnx": ("onnx",),
}  # fmt: skip
"""Optional packages that write files, by suffix."""


def names_of(*groups: str) -> Callable[[str], list[str]]:
    """Return a shell completion by the entry-point names of groups, such as `robots`."""

    def complete(incomplete: str) -> list[str]:
        names = {one.name for group in groups for one in entry_points(group=f"kinfeas.{group}")}
        return sorted(name for name in names if name.startswith(incomplete))

    return complete


def complete_policy(incomplete: str) -> list[str]:
    """Return the names of policies and the training runs in `runs` that begin with a text."""
    runs = {str(path.parent) for path in Path("runs").glob("*/config.yaml")}
    names = {"pretrained", *runs, *registry.names("kinfeas.policies")}
    return sorted(name for name in names if name.startswith(incomplete))


def output_file(*suffixes: str) -> Callable[[Path | None], Path | None]:
    """Return a callback that checks that a file of one of the suffixes can be written."""

    def check(path: Path | None) -> Path | None:
        if path is not None:
            check_suffix(path, *suffixes)
            require(*_WRITERS.get(path.suffix.lower(), ()))
        return check_file_path(path)

    return check


def _read_json_path(context: typer.Context, path: Path | None) -> Path | None:
    """Return the path of the JSON; with standard output, tables go to standard error."""
    if path not in (STDOUT, Path("/dev/stdout")):
        return check_file_path(path)
    context.with_resource(redirect_stdout(sys.stderr))
    return STDOUT


def file_option(text: str, *suffixes: str) -> Any:
    """Return an option for a file to write that ends in one of the suffixes."""
    return typer.Option(metavar=f"FILE{suffixes[0]}", help=text, callback=output_file(*suffixes))


def episodes_option(text: str) -> Any:
    """Return an option for a number of episodes."""
    return typer.Option(min=1, max=MOST_EPISODES, help=text)


def robot_option(default: str = "") -> Any:
    """Return an option for a robot; the text on its default is added to the help."""
    text = f"Robot: pr2, tiago, hsr, or a YAML file.{default}"
    return typer.Option(help=text, autocompletion=names_of("robots"))


def task_option(before: str = "", default: str = "") -> Any:
    """Return an option for a task, with texts before and after its help."""
    tasks = "Task: ggr, pick_place, door, drawer, another of `plugins list`, or a YAML file."
    return typer.Option(help=before + tasks + default, autocompletion=names_of("tasks"))


RobotName = Annotated[str, robot_option()]
PolicyRobotName = Annotated[str | None, robot_option("  [default: that of the policy]")]
TaskName = Annotated[str, task_option()]
PolicyName = Annotated[
    str,
    typer.Option(
        help="Run folder, ONNX file, module:Class, or a name such as pretrained or follow_ee.",
        autocompletion=complete_policy,
    ),
]
PolicyArgument = Annotated[
    str,
    typer.Argument(
        help="ONNX file, run folder, module:Class, or a name such as pretrained.",
        autocompletion=complete_policy,
    ),
]
World = Annotated[
    str,
    typer.Option(
        help="Backend: analytic, pybullet, mujoco, or a plugin.",
        autocompletion=names_of("backends"),
    ),
]
Episodes = Annotated[int, episodes_option("Number of episodes.")]
Seed = Annotated[int, typer.Option(min=0, max=LAST_SEED, help="Random seed.")]
Processes = Annotated[int, typer.Option(min=1, max=MOST_PROCESSES, help="Parallel processes.")]
AllProcesses = Annotated[
    int | None,
    typer.Option(
        min=1, max=MOST_PROCESSES, help="Number of jobs at a time.  [default: one for each core]"
    ),
]
EngineName = Annotated[
    str,
    typer.Option(
        help="Where jobs run: local, ray, or a mapping such as {name: ray, address: auto}."
    ),
]
EngineAddress = Annotated[
    str | None, typer.Option(help="Address of a running Ray cluster, such as auto.")
]
RobotBackend = Annotated[
    str | None,
    typer.Option(
        help="analytic, pybullet, mujoco, ros2, ros1, or a plugin.  "
        "[default: pybullet or, without it, mujoco]",
        autocompletion=names_of("backends"),
    ),
]
Rate = Annotated[float, typer.Option(min=1.0, max=1000.0, help="Control rate, Hz.")]
Record = Annotated[
    Path | None,
    typer.Option(metavar="FILE.csv", help="New file.  [default: one below runs/deploy]"),
]
GuardsFile = Annotated[
    Path | None, typer.Option("--guards", metavar="FILE.yaml", help="Limits of the guards.")
]
AdapterList = Annotated[
    str | None,
    typer.Option(help="paper, pr2_like, harsh, randomised, or a file."),
]
Filters = Annotated[
    str | None,
    typer.Option(
        metavar="NAMES",
        help="Such as path_planner,feasibility, or none.  [default: the robot's]",
    ),
]
Overrides = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Change a setting; may be repeated."),
]
JsonPath = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="Write results as JSON; - is standard output.",
        callback=_read_json_path,
    ),
]
Picture = Annotated[Path | None, file_option("Draw a picture.", ".png")]

Video = Annotated[
    Path | None,
    file_option("Episode as .gif or .mp4, or four frames as .png.", ".gif", ".mp4", ".png"),
]


def read_robot(name: str) -> "Robot":
    """Return a robot by name or path."""
    from kinfeas.robots.loading import load_robot

    return load_robot(name)


def read_task(name: str, parameters: dict[str, object]) -> "Task":
    """Return a task by name or path."""
    from kinfeas.tasks.loading import load_task

    return load_task(name, parameters)


def adapters_of_world(name: str | None) -> dict[str, object]:
    """Return the adapters of `--adapters` by the key of an assignment; nothing for None."""
    return {} if name is None else {"world.adapters": [vars(one) for one in read_adapters(name)]}


def read_adapters(name: str | None) -> "tuple[PluginSpec, ...]":
    """Return a list of adapters by name or path; none for None."""
    from kinfeas.control.assemble import read_sim2real

    return () if name is None else read_sim2real(name).adapters


def robot_of(policy: str | None) -> str:
    """Return the robot that a policy was trained for, by name or path; pr2 for other policies."""
    from kinfeas.io.policy_metadata import read_trained
    from kinfeas.policies.onnx_policy import read_policy_file

    path = Path(policy or "")
    if not policy or policy in registry.names("kinfeas.policies") or not path.exists():
        return DEFAULT_ROBOT
    trained = read_trained(path) if path.is_dir() else read_policy_file(path, None).metadata
    robot = trained.trained_with
    if is_path(robot) and not Path(robot).is_file():
        raise KinfeasError(f"{policy}: its robot {robot} does not exist; use --robot")
    return robot


def read_engine(text: str, processes: int | None, address: str | None) -> "Engine":
    """Return an engine by its name or parameters."""
    from kinfeas.jobs.job import build_engine

    return build_engine(text, processes or os.cpu_count() or 1, address)


def assignments(values: Mapping[str, object]) -> list[str]:
    """Return values by key as assignments of `--set`."""
    return [
        f"{key}={json.dumps(value, ensure_ascii=False, default=_plain)}"
        for key, value in values.items()
    ]


def given(values: Mapping[str, object]) -> dict[str, object]:
    """Return the values that are not None, as options that are not given are."""
    return {key: value for key, value in values.items() if value is not None}


def _plain(value: Any) -> object:
    if isinstance(value, Path):
        return str(value)
    if hasattr(value, "tolist"):  # of NumPy
        return value.tolist()
    raise KinfeasError(f"{value!r} is no value of a setting")


def with_filters(
    filters: str | Sequence[str] | None, overrides: Sequence[str], prefix: str = "world."
) -> list[str]:
    """Return assignments with filters that replace the robot's own; None keeps those.

    The filters are names, also as one text with commas, or `none`.
    """
    if filters is None:
        return list(overrides)
    return [*assignments({f"{prefix}filters": filter_names(filters)}), *overrides]


def filter_names(filters: str | Sequence[str]) -> list[str]:
    """Return names of filters, which may be one text with commas or `none`."""
    names = filters.split(",") if isinstance(filters, str) else filters
    return [name.strip() for name in names if name.strip() not in ("", "none")]
