"""What `kinfeas evaluate --video` and `--replay` show: one episode, once more."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from kinfeas.cli.output import check_file_path, progress, say_written, status
from kinfeas.core.errors import KinfeasError

if TYPE_CHECKING:
    from kinfeas.core.policy import Policy
    from kinfeas.evaluation.evaluate import EvalConfig
    from kinfeas.viz.film import Film


def _check_video(path: Path | None) -> Path | None:
    if path is not None:
        from kinfeas.viz.film import check_film_path

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
        help="Write an episode as a film, .gif or .mp4, or four of its moments, .png.",
        callback=_check_video,
    ),
]
Replay = Annotated[
    Path | None,
    typer.Option(
        "--replay",
        help="Write an episode as a page to turn about in a browser, .html.",
        callback=_check_replay,
    ),
]
Episode = Annotated[
    int | None,
    typer.Option(
        "--episode",
        min=0,
        help="Number of that episode, below --episodes; by default 0, the first one.",
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
        raise KinfeasError("--episode needs --video, --replay or --picture")
    if episode >= count:
        raise KinfeasError(f"--episode must be below --episodes, {count}, not {episode}")
    return episode


def show_episode(
    chosen: "EvalConfig",
    policy: "Policy",
    episode: int,
    outputs: Mapping[str, Path | None],
) -> None:
    """Run an episode once more and write it as film, page or picture.

    Args:
        chosen: The evaluation.
        policy: Moves the base.
        episode: Number of the episode.
        outputs: Where to, by the option; nowhere if None.
    """
    if not any(outputs.values()):
        return
    if chosen.world.backend == "pybullet":
        _show_physics(chosen, policy, episode, outputs)
    else:
        _show_analytic(chosen, policy, episode, outputs)


def _show_physics(
    chosen: "EvalConfig", policy: "Policy", episode: int, outputs: Mapping[str, Path | None]
) -> None:
    from kinfeas.envs.world import World
    from kinfeas.viz.pages import pybullet_html
    from kinfeas.viz.pybullet_film import make_film, record

    world = World(chosen.robot, chosen.task, chosen.world, chosen.seed)
    try:
        with status(f"episode {episode}"):
            recording = record(world, policy, episode)
            film = make_film(world, recording)
        _write_film(film, outputs["--video"])
        _write(outputs["--replay"], lambda: pybullet_html(film).encode())
        _write_film(film, outputs["--picture"])
    finally:
        world.close()


def _show_analytic(
    chosen: "EvalConfig", policy: "Policy", episode: int, outputs: Mapping[str, Path | None]
) -> None:
    from kinfeas.envs.world import World
    from kinfeas.evaluation.recording import record_episodes
    from kinfeas.viz.episodes import EpisodeFilm, episodes_figure
    from kinfeas.viz.pages import episode_html
    from kinfeas.viz.style import png

    robot = chosen.robot
    with status(f"episode {episode}"):
        world = World(robot, chosen.task, chosen.world, chosen.seed)
        (recording,) = record_episodes(world, policy, 1, first=episode)
    film = EpisodeFilm(recording, robot, f"{robot.name}, {chosen.task.name}")
    _write_film(film, outputs["--video"])
    _write(outputs["--replay"], lambda: episode_html(recording, robot, film.times).encode())
    _write(outputs["--picture"], lambda: png(episodes_figure(robot, [recording]), dpi=110))


def _write_film(film: "Film", path: Path | None) -> None:
    from kinfeas.viz.film import count_pictures, write_film

    if path is not None:
        with progress("drawing", count_pictures(film, path)) as advance:
            write_film(film, path, advance)
        say_written(path)


def _write(path: Path | None, content: Callable[[], bytes]) -> None:
    from kinfeas.io.files import write_file

    if path is not None:
        with status("drawing"):
            write_file(path, content())
        say_written(path)
