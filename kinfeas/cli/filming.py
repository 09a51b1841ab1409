"""What `kinfeas evaluate --video` and `--replay` show: one episode, once more."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from kinfeas.cli.output import check_file_path, progress, status
from kinfeas.errors import KinfeasError

if TYPE_CHECKING:
    from kinfeas.evaluation.physics.film import Film
    from kinfeas.evaluation.physics.world import PhysicsTrial
    from kinfeas.policy import Policy


def _check_video(path: Path | None) -> Path | None:
    if path is not None:
        from kinfeas.evaluation.physics.film import check_film_path

        check_film_path(path)
    return check_file_path(path)


def _check_replay(path: Path | None) -> Path | None:
    if path is not None and path.suffix.lower() not in (".html", ".htm"):
        raise KinfeasError(f"{path}: a replay is a page and must end in .html")
    return check_file_path(path)


Video = Annotated[
    Path | None,
    typer.Option(
        "--video",
        help="pybullet: write an episode as a film, .gif or .mp4, or four of its moments, .png.",
        callback=_check_video,
    ),
]
Replay = Annotated[
    Path | None,
    typer.Option(
        "--replay",
        help="pybullet: write an episode as a page to turn about in a browser, .html.",
        callback=_check_replay,
    ),
]
Episode = Annotated[
    int | None,
    typer.Option(
        "--episode",
        min=0,
        help="pybullet: number of that episode, below --episodes; by default 0, the first one.",
    ),
]


def shown_episode(episode: int | None, count: int, *, shown: bool) -> int:
    """Return the number of the episode to show.

    Args:
        episode: What --episode says; None if it was not given.
        count: How many episodes there are.
        shown: Whether any is to be shown.

    Raises:
        KinfeasError: If there is no such episode, or none is to be shown.
    """
    if episode is None:
        return 0
    if not shown:
        raise KinfeasError("--episode needs --video or --replay")
    if episode >= count:
        raise KinfeasError(f"--episode must be below --episodes, {count}, not {episode}")
    return episode


def show_episode(
    trial: "PhysicsTrial", policy: "Policy", episode: int, video: Path | None, replay: Path | None
) -> None:
    """Run an episode once more and write it as film, page or both."""
    from kinfeas.evaluation.physics.film import count_pictures, make_film, write_film
    from kinfeas.evaluation.physics.recording import record
    from kinfeas.evaluation.physics.world import PhysicsWorld

    world = PhysicsWorld(trial)
    try:
        with status(f"episode {episode}"):
            recording = record(world, trial, policy, episode)
            film = make_film(world, trial, recording)
        if video is not None:
            with progress("drawing", count_pictures(recording, video)) as advance:
                write_film(film, video, advance)
            typer.echo(str(video))
        if replay is not None:
            _write_page(film, replay)
    finally:
        world.close()


def _write_page(film: "Film", path: Path) -> None:
    from kinfeas.evaluation.pages.film import film_html
    from kinfeas.storage.files import write_file

    with status("page"):
        write_file(path, film_html(film).encode())
    typer.echo(str(path))
