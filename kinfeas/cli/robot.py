"""`kinfeas robot import`: the files of a robot, from its URDF, xacro or MJCF."""

import os
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import typer

from kinfeas.api import counter
from kinfeas.cli import options
from kinfeas.cli.options import argument, option
from kinfeas.cli.output import print_facts, progress, write_drawing, write_json
from kinfeas.core.errors import KinfeasError

if TYPE_CHECKING:
    from kinfeas.importer.draft import Draft

Drive = Literal["differential", "omnidirectional"]
app = typer.Typer(no_args_is_help=True, help="Create the files of a robot.")


@app.command("import")
def import_robot(  # noqa: PLR0913, PLR0917 - each option is an argument
    file: Path = argument(..., "URDF, xacro or MJCF of a mobile manipulator.", metavar="FILE"),
    arguments: list[str] | None = argument(None, "Arguments of a xacro.", metavar="NAME:=VALUE"),
    out: Path = option(..., "Folder of the robot, for its three files."),
    name: str | None = option(None, "Name of the robot.  [default: that of the folder]"),
    drive: Drive | None = option(None, "Drive of the base.  [default: by the wheels]"),
    ee: str | None = option(None, "EE link.  [default: end of the longest chain]"),
    base: str | None = option(None, "Base link; links above it are left out.  [default: the root]"),
    no_meshes: bool = option(False, "Leave meshes out.", "--no-meshes"),
    mesh_path: list[str] | None = option(
        None, "Replaces the start of mesh addresses; may be repeated.", metavar="OLD=NEW"
    ),
    json: options.JsonPath = None,
    picture: options.Picture = None,
) -> None:
    """Draft the folder of a robot from its URDF, xacro or MJCF.

    robot.yaml has arm, hand, home, reach and ignored collisions, and marks guesses: check them,
    above all the speed of the base. In robot.urdf, primitives replace collision meshes.

    Example: kinfeas robot import fetch.urdf --out robots/fetch --picture fetch.png
    """
    from kinfeas.core.errors import check_name
    from kinfeas.core.files import check_file_path, write_file, writing
    from kinfeas.importer.draft import draft_robot
    from kinfeas.importer.text import warnings

    robot_name = out.resolve().name if name is None else name
    try:
        check_name(robot_name)
    except ValueError as error:
        raise KinfeasError(f"--name: {error}") from error
    yaml_path, urdf_path = out / "robot.yaml", out / "robot.urdf"
    for path in (yaml_path, urdf_path):
        if path.exists():
            raise KinfeasError(f"{path}: exists; choose another --out")
    replacements = dict(_replacement(text) for text in mesh_path or ())
    xacro_arguments = dict(_argument(text) for text in arguments or ())
    with progress() as on_progress:
        draft = draft_robot(
            file, robot_name, ee, base, drive, counter(on_progress, f"reading {file.name}"),
            meshes=not no_meshes, mesh_paths=replacements, arguments=xacro_arguments,
        )  # fmt: skip
    with writing(out):
        out.mkdir(parents=True, exist_ok=True)
    for path, text in ((urdf_path, draft.urdf), (yaml_path, draft.yaml)):
        check_file_path(path)
        write_file(path, text.encode())
    summary = _summary(draft)
    messages = [*draft.guesses.doubts, *warnings(draft.spec, draft.guesses, draft.free)]
    write_json({**summary, "warnings": messages}, json)
    print_facts(f"robot {robot_name}", summary)
    for message in messages:
        typer.echo(f"warning: {message}", err=True)
    quoted = shlex.quote(str(out) if os.sep in str(out) else f"./{out}")
    typer.echo(f"next: check the guesses in {yaml_path}, then kinfeas ceiling --robot {quoted}")
    write_drawing(lambda: _drawing(draft), picture)


def _replacement(text: str) -> tuple[str, str]:
    old, equals, new = text.partition("=")
    if not (old and equals and new):
        raise KinfeasError(f"--mesh-path {text}: must have the form OLD=NEW")
    return old, new if "://" in new else str(Path(new).absolute())


def _argument(text: str) -> tuple[str, str]:
    name, separator, value = text.partition(":=")
    if not (name and separator):
        raise KinfeasError(f"{text}: arguments of a xacro have the form NAME:=VALUE")
    return name, value


def _drawing(draft: "Draft") -> bytes:
    from kinfeas.viz.drawing import robot_figure
    from kinfeas.viz.style import png

    return png(robot_figure(draft.robot), dpi=130)


def _summary(draft: "Draft") -> dict[str, object]:
    from kinfeas.config import to_mapping

    guesses = draft.guesses
    return {
        **to_mapping(draft.spec),
        "free_of_self_collision": draft.free,
        "overloaded": dict(guesses.overloads),
        "overloaded_at_home": list(guesses.overloaded_at_home),
        "heights_m": draft.heights.at.tolist(),
        "reachable": draft.heights.fraction.tolist(),
        "root_above_floor_m": guesses.lifted,
        "guessed_velocities": list(guesses.speeds),
        "guessed_limits": list(guesses.limits),
        "joints_without_room": list(guesses.stuck),
        **({"drive_from": guesses.drive} if guesses.drive else {}),
        **({"no_gripper": guesses.no_gripper} if guesses.no_gripper else {}),
    }
