"""`kinfeas demonstrate`: a simulated hand opens a door or a drawer and records itself."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from kinfeas.cli import options
from kinfeas.cli.output import (
    check_file_path,
    check_outputs,
    print_table,
    say_written,
    status,
    write_json,
)
from kinfeas.core.errors import KinfeasError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from kinfeas.io.demonstrations import Demonstration
    from kinfeas.scenes.demonstrate import Take
    from kinfeas.scenes.exercise import Exercise

Figures = dict[str, float]


def demonstrate(  # noqa: PLR0913, PLR0917 - each option is an argument
    mechanism: Annotated[
        Literal["door", "drawer"], typer.Argument(help="What the hand opens.", show_default=False)
    ],
    out: Annotated[
        Path, typer.Option("--out", help="New folder for grasp/ and open/, a file for each try.")
    ],
    count: Annotated[int, typer.Option("--count", min=1, max=10_000, help="Number of tries.")] = 12,
    seed: options.Seed = 0,
    file_format: Annotated[
        Literal["csv", "npz"], typer.Option("--format", help="Kind of the files.")
    ] = "csv",
    json: options.JsonPath = None,
    picture: Annotated[
        Path | None,
        typer.Option(
            "--picture",
            help="Draw the tries, and the shipped motions from other starts, into this PNG.",
            callback=check_file_path,
        ),
    ] = None,
) -> None:
    """Let a simulated hand show how a door or a drawer is grasped and opened.

    Each try is two demonstrations, of the grasp and of the opening, with the furniture elsewhere
    in the room each time: what [bold]kinfeas fit[/] learns the shipped motions from.
    """
    from kinfeas.scenes.demonstrate import demonstrate as show
    from kinfeas.scenes.demonstrate import load_habits
    from kinfeas.scenes.exercise import load_exercise

    check_outputs({"--out": out, "--json": json, "--picture": picture})
    _make_folders(out)
    exercise = load_exercise(mechanism)
    with status(f"opening a {mechanism}"):
        takes = show(exercise, load_habits(), count, seed)
    motions = {"grasp": [take.grasp for take in takes], "open": [take.open for take in takes]}
    for name, shown in motions.items():
        _write(shown, out / name, file_format)
    figures = {name: _figures(shown) for name, shown in motions.items()}
    if json is not None:
        write_json({"mechanism": mechanism, "seed": seed, "count": count, **figures}, json)
    if picture is not None:
        with status("drawing"):
            _draw(mechanism, exercise, takes, picture)
    _show(f"{count} demonstrations of a {mechanism}, seed {seed}, in {out}", figures)
    say_written(picture)


def _make_folders(folder: Path) -> None:
    from kinfeas.io.files import writing

    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise KinfeasError(f"{folder}: is there already, --out needs a new or an empty folder")
    with writing(folder):
        for motion in ("grasp", "open"):
            (folder / motion).mkdir(parents=True)


def _write(shown: "Sequence[Demonstration]", folder: Path, suffix: str) -> None:
    from kinfeas.io.demonstrations import write_demonstration

    digits = max(2, len(str(len(shown) - 1)))
    for number, demonstration in enumerate(shown):
        write_demonstration(demonstration, folder / f"{number:0{digits}d}.{suffix}")


def _figures(shown: "Sequence[Demonstration]") -> Figures:
    """Return what is told of the demonstrations of one motion: extremes and means."""
    import numpy as np

    from kinfeas.core.spatial import distance

    durations = [float(one.time[-1] - one.time[0]) for one in shown]
    ways = [float(np.sum(distance(one.ee_pose[1:], one.ee_pose[:-1])[0])) for one in shown]
    turns = [float(distance(one.ee_pose[-1], one.ee_pose[0])[1]) for one in shown]
    travels = [float(distance(one.base_pose[-1], one.base_pose[0])[0]) for one in shown]
    return {
        "min_duration_s": min(durations),
        "max_duration_s": max(durations),
        "hand_path_m": float(np.mean(ways)),
        "hand_turn_rad": float(np.mean(turns)),
        "base_travel_m": float(np.mean(travels)),
    }


def _draw(mechanism: str, exercise: "Exercise", takes: "Sequence[Take]", path: Path) -> None:
    from kinfeas.io.files import write_file
    from kinfeas.viz.pictures.demonstrations import demonstrations_figure
    from kinfeas.viz.pictures.style import png

    write_file(path, png(demonstrations_figure(mechanism, exercise, takes), dpi=130))


def _show(title: str, figures: dict[str, Figures]) -> None:
    from numpy import rad2deg

    rows = [
        [
            name,
            f"{of['min_duration_s']:.1f} - {of['max_duration_s']:.1f} s",
            f"{of['hand_path_m']:.3f} m",
            f"{rad2deg(of['hand_turn_rad']):.1f} deg",
            f"{of['base_travel_m']:.3f} m",
        ]
        for name, of in figures.items()
    ]
    print_table(title, ["motion", " duration", " hand path", " hand turn", " base travel"], rows)
