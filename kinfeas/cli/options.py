"""Options that several commands share, and how they are read."""

import json
import sys
from collections.abc import Mapping, Sequence
from contextlib import redirect_stdout
from pathlib import Path
from types import NoneType, UnionType
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    TypeVar,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

import typer

from kinfeas.cli import completion
from kinfeas.cli.output import check_file_path
from kinfeas.config.quantities import LAST_SEED, MOST_EPISODES, MOST_PROCESSES

if TYPE_CHECKING:
    from kinfeas.config import PluginSpec
    from kinfeas.robots.robot import Robot
    from kinfeas.tasks.task import Task

T = TypeVar("T")

ROBOT_HELP = "Robot by name (pr2, tiago, hsr) or path of its YAML."
TASK_HELP = "Task by name (ggr, ggr_restricted, pick_place, door, drawer) or path of its YAML."

RobotName = Annotated[
    str, typer.Option("--robot", help=ROBOT_HELP, autocompletion=completion.plugins("robots"))
]
PolicyRobotName = Annotated[
    str | None,
    typer.Option(
        "--robot",
        help=f"{ROBOT_HELP[:-1]}; by default the one that the policy was trained for, and pr2 for "
        "pretrained and baselines.",
        autocompletion=completion.plugins("robots"),
    ),
]
TaskName = Annotated[
    str, typer.Option("--task", help=TASK_HELP, autocompletion=completion.plugins("tasks"))
]
PolicyName = Annotated[
    str,
    typer.Option(
        "--policy",
        help="Folder of a training run, file of an export, pretrained, or a baseline: follow_ee, "
        "follow_ee_feedback, demonstrated_base, geometric_modulation or whole_body_qp.",
        autocompletion=completion.policies,
    ),
]
PluginName = Annotated[
    str,
    typer.Argument(
        help="Name of a plugin, or path of a robot's or a task's YAML.",
        autocompletion=completion.every_plugin,
    ),
]
Episodes = Annotated[
    int, typer.Option("--episodes", min=1, max=MOST_EPISODES, help="Number of episodes.")
]
Seed = Annotated[
    int,
    typer.Option(
        "--seed",
        min=0,
        max=LAST_SEED,
        help="Of all randomness; the same seed, the same result.",
    ),
]
Processes = Annotated[
    int,
    typer.Option(
        "--processes",
        min=1,
        max=MOST_PROCESSES,
        help="Processes that share the work; no result depends on it.",
    ),
]
Overrides = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Change one of the settings named above; may be repeated.",
    ),
]
Sim2RealName = Annotated[
    str | None,
    typer.Option(
        "--adapters",
        help="What stands between policy and robot: ideal, paper, pr2_like, harsh, or a YAML file.",
    ),
]


def _read_json_path(context: typer.Context, path: Path | None) -> Path | None:
    """Return where the JSON goes; if to standard output, all else goes to standard error."""
    from kinfeas.io.files import is_standard_output

    target = Path("/dev/stdout") if path == Path("-") else check_file_path(path)
    if target is not None and is_standard_output(target):
        context.with_resource(redirect_stdout(sys.stderr))
    return target


JsonPath = Annotated[
    Path | None,
    typer.Option(
        "--json",
        help="Write the results as JSON to this file; - is standard output, and tables then go to "
        "standard error.",
        callback=_read_json_path,
    ),
]


Filters = Annotated[
    str | None,
    typer.Option(
        "--filters",
        metavar="NAMES",
        help="Command filters in place of the robot's own, in this order, such as "
        "rollout_planner,feasibility; none for none.",
    ),
]


def read_overrides(cls: type[T], overrides: list[str] | None) -> T:
    """Return the settings `cls` with what `--set` says of them."""
    from kinfeas import config

    return config.from_mapping(cls, {}, "settings", overrides or ())


def with_filters(
    filters: str | Sequence[str] | None, overrides: Sequence[str], prefix: str = "world."
) -> list[str]:
    """Return assignments, with the filters that replace the robot's own in `PREFIXfilters`.

    Args:
        filters: Names, also as one text with commas, or `none`; None to keep the robot's own.
        overrides: Assignments.
        prefix: Of the key.
    """
    if filters is None:
        return list(overrides)
    names = filters.split(",") if isinstance(filters, str) else filters
    listed = [{"name": name.strip()} for name in names if name.strip() not in ("", "none")]
    return [f"{prefix}filters={json.dumps(listed)}", *overrides]


def check_settings(cls: type, said: Mapping[str, tuple[str, object]]) -> None:
    """Check options that stand for settings, so that an error names the option.

    Args:
        cls: Dataclass of the settings.
        said: Key of a setting, such as `schedule.steps`, and its value, by the option; None if it
            was not given.

    Raises:
        KinfeasError: If a value has a wrong type or range.
    """
    from kinfeas.config import convert

    for option, (key, value) in said.items():
        kind: Any = cls
        for name in key.split("."):
            kind = get_type_hints(kind, include_extras=True)[name]
        if get_origin(kind) in (Union, UnionType):  # null is nothing that an option can say
            kind = next(one for one in get_args(kind) if one is not NoneType)
        if value is not None:
            convert(kind, value, option, key)


def check_robot(name: str | None) -> None:
    """Check that what `--robot` names is there, before anything slow is imported.

    Args:
        name: Name or path; None if it was not given.

    Raises:
        KinfeasError: If there is no robot of that name.
    """
    from kinfeas.io.files import is_path

    if name is not None and not is_path(name) and name not in completion.plugins("robots")(""):
        read_robot(name)  # which says what there is, or finds what this process has registered


def read_robot(name: str) -> "Robot":
    """Return the robot that `--robot` names."""
    from kinfeas.robots.loading import load_robot

    return load_robot(name)


def read_adapters(name: str) -> "tuple[PluginSpec, ...]":
    """Return the adapters that `--adapters` names."""
    from kinfeas.control.adapters import read_sim2real

    return read_sim2real(name).adapters


def read_task(name: str, parameters: dict[str, object]) -> "Task":
    """Return the task that `--task` names."""
    from kinfeas.tasks.loading import load_task

    return load_task(name, parameters)
