"""`kinfeas robot import`: the files of a robot, from its URDF."""

import shlex
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from kinfeas.cli import options
from kinfeas.cli.commands import Command, Group
from kinfeas.cli.docstrings import unwrapped
from kinfeas.cli.examples import epilog
from kinfeas.cli.output import (
    check_file_path,
    check_outputs,
    print_table,
    progress,
    say_written,
    share,
    status,
    write_json,
)
from kinfeas.core.errors import KinfeasError

if TYPE_CHECKING:
    from kinfeas.importer.draft import Draft
    from kinfeas.robots.robot import Robot


def import_urdf(  # noqa: PLR0913, PLR0917 - each option is an argument
    urdf: Annotated[
        Path,
        typer.Argument(metavar="FILE.urdf", help="URDF of a mobile manipulator, meshes or not."),
    ],
    out: Annotated[
        Path, typer.Option("--out", help="Folder for NAME.yaml and NAME.urdf, which are new there.")
    ],
    name: Annotated[
        str | None,
        typer.Option("--name", help="Short name of the robot; by default that of the URDF file."),
    ] = None,
    drive: Annotated[
        Literal["differential", "omnidirectional"] | None,
        typer.Option("--drive", help="How the base moves; by default differential, a guess."),
    ] = None,
    ee: Annotated[
        str | None,
        typer.Option(
            "--ee",
            help="Link that IK places; by default where the longest chain of joints parts into "
            "fingers.",
        ),
    ] = None,
    base: Annotated[
        str | None,
        typer.Option(
            "--base",
            help="Link that is the base; what it does not carry is left out. By default the root, "
            "or what joints carry that stand for a floor.",
        ),
    ] = None,
    json: options.JsonPath = None,
    picture: Annotated[
        Path | None,
        typer.Option(
            "--picture", help="Draw the robot at its home into this PNG.", callback=check_file_path
        ),
    ] = None,
) -> None:
    """Draft the YAML of a robot from its URDF: arm, hand, home, heights, links that may touch.

    Meshes become primitives in a URDF beside it, so that self-collision is checked and nothing
    else is needed. What is guessed is called so in the YAML: [bold]look at it[/], the base's speed
    above all.
    """
    from kinfeas.importer.draft import DraftOptions, draft_robot

    called = _checked_name(urdf.stem if name is None else name)
    yaml_path, urdf_path = (out / f"{called}.{kind}" for kind in ("yaml", "urdf"))
    written = {"--json": json, "--picture": picture}
    check_outputs(written, {"FILE.urdf": [urdf], "--out": [yaml_path, urdf_path]})
    with _folder_for(out, (yaml_path, urdf_path)):
        with progress(f"looking at {urdf.name}") as advance:
            wishes = DraftOptions(called, ee, base, drive or DraftOptions.drive)
            draft = draft_robot(urdf, wishes, advance)
        if picture is not None:
            with status("drawing"):
                _draw(draft.robot, picture)
        _write(draft, yaml_path, urdf_path)
    if json is not None:
        write_json(_figures(draft), json)
    _show(draft, yaml_path, drive_given=drive is not None)
    say_written(picture)


def _checked_name(name: str) -> str:
    from kinfeas.core.errors import check_name

    try:
        check_name(name)
    except ValueError as error:
        raise KinfeasError(f"--name: {error}") from error
    return name


@contextmanager
def _folder_for(folder: Path, files: tuple[Path, ...]) -> Iterator[None]:
    """Make a folder for files that are new there; it goes again if they do not come."""
    from kinfeas.io.files import writing

    fresh = [one for one in (folder, *folder.parents) if not one.exists()]
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    try:
        for path in files:
            if path.exists():
                raise KinfeasError(f"{path}: is there already, --out needs a folder without it")
            check_file_path(path)
        yield
    finally:
        with suppress(OSError):  # of a folder that is not empty
            for one in fresh:
                one.rmdir()


def _write(draft: "Draft", yaml_path: Path, urdf_path: Path) -> None:
    from kinfeas.io.files import write_file

    write_file(urdf_path, draft.urdf.encode())
    write_file(yaml_path, draft.yaml.encode())


def _figures(draft: "Draft") -> dict[str, object]:
    spec, guesses = draft.spec, draft.guesses
    return {
        "robot": spec.name,
        "ee_frame": spec.ee_frame,
        "tool_tip": list(spec.tool_tip),
        "gripper_rotation": list(spec.gripper_rotation),
        "base": asdict(spec.base),
        "arm": list(spec.arm),
        "home": list(spec.home["home"]),
        "goal_heights": {name: list(band) for name, band in spec.goal_heights.items()},
        "ignored_collisions": [list(pair) for pair in spec.ignored_collisions],
        "free_of_self_collision": draft.free,
        "heights_m": draft.heights.at.tolist(),
        "reachable": draft.heights.share.tolist(),
        "root_above_floor_m": guesses.lifted,
        "guessed_velocities": list(guesses.speeds),
        "guessed_limits": list(guesses.limits),
    }


def _draw(robot: "Robot", path: Path) -> None:
    from kinfeas.io.files import write_file
    from kinfeas.viz.figures import robot_figure
    from kinfeas.viz.style import png

    write_file(path, png(robot_figure(robot), dpi=130))


def _show(draft: "Draft", path: Path, *, drive_given: bool) -> None:
    from kinfeas.importer.text import guessed

    spec, guesses = draft.spec, draft.guesses
    (low, high), (easy_low, easy_high) = spec.goal_heights.values()
    fingers = "none found" if spec.gripper is None else ", ".join(spec.gripper.fingers)
    rows = [
        ["EE frame", spec.ee_frame],
        ["arm", f"{len(spec.arm)} joints: {', '.join(spec.arm)}"],
        ["fingers", fingers],
        ["goal heights", f"{low:g} - {high:g} m, comfortable {easy_low:g} - {easy_high:g} m"],
        ["free of self-collision", f"{share(draft.free)} of all configurations"],
        ["pairs of links that may touch", str(len(spec.ignored_collisions))],
    ]
    if "<collision>" not in draft.urdf:
        rows.append(["shapes", "none: what touches what is not looked at"])
    if guesses.lifted:
        rows.append(["root", f"{guesses.lifted:g} m above the floor: one on it was added"])
    if guesses.stand:
        rows.append(["base", f"is {guesses.stand} one that drives, or the arm's own first link?"])
    if guesses.stuck:
        rows.append(["stand still, for lack of room", ", ".join(guesses.stuck)])
    print_table(f"{spec.name}, as its URDF has it", ["", "found"], rows)
    found = guessed(spec, guesses)
    if drive_given:
        del found["base.drive"]
    print_table("guesses, to be checked", ["key", "value"], [list(row) for row in found.items()])
    typer.echo(f"look through it: {path}")
    typer.echo(f"what it can reach: kinfeas ceiling --robot {shlex.quote(str(path))}")


app = typer.Typer(cls=Group, no_args_is_help=True, help="Make the files of a robot.")
app.command("import", cls=Command, help=unwrapped(import_urdf), epilog=epilog("robot import"))(
    import_urdf
)
