"""Scenes and recorded runs as tables, pictures and pages."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from kinfeas.api import Name, OnProgress, counter
from kinfeas.api.load import load_robot, text_of
from kinfeas.config import Settings
from kinfeas.core.errors import KinfeasError
from kinfeas.core.files import check_file_path, write_file
from kinfeas.io.run_log import Record, read_record
from kinfeas.robots.robot import Robot
from kinfeas.scenes.scene import Scene, read_scene

if TYPE_CHECKING:
    from kinfeas.viz.replay import EpisodeReplay


def view(  # noqa: PLR0913 - options of the command
    scene: Name | None = None,
    *,
    record: Name | None = None,
    settings: Settings | None = None,
    picture: Name | None = None,
    video: Name | None = None,
    html: Name | None = None,
    on_progress: OnProgress | None = None,
) -> dict[str, object]:
    """Return facts on a scene or on a recorded run, and draw it.

    Example: `kinfeas.view(record="run.csv", picture="run.png")["seconds"]`

    Arguments are the options of the command: `picture`, `video` and `html` are files to write;
    only runs have a video. `settings` are values by key of the scene.

    Raises:
        KinfeasError: If a file or a setting is invalid.
    """
    if record is None and video is not None:
        raise KinfeasError("'video' needs 'record'")
    check_files(picture=picture, video=video, html=html)
    if record is None:
        layout = read_scene(str(scene or "room"), settings)
        facts = _scene_facts(layout)
        if picture is not None or html is not None:
            counter(on_progress, "drawing")
            _draw_scene(layout, picture, html)
        return facts
    if scene is not None or settings:
        raise KinfeasError("'record' excludes 'scene' and settings")
    run = read_record(Path(text_of(record, "record")))
    robot, facts = load_robot(run.about.robot), _run_facts(run)
    if picture is not None or video is not None or html is not None:
        from kinfeas.viz.replay import as_recording, replay_of

        # Records have the poses of objects at the start only.
        title = f"{robot.name}, furniture as at the start" if run.about.scene else robot.name
        replay = replay_of(as_recording(run, robot), robot, title)
        end = run.event[-1] or "the record breaks off"
        about = f"{robot.name}, {run.about.task}, {facts['seconds']:.0f} s: {end}"
        write_files(replay, robot, picture, video, html, title=about, on_progress=on_progress)
    return facts


def check_files(**files: Name | None) -> None:
    """Raise KinfeasError if a file, passed by its argument's name, cannot be written."""
    for name, file in files.items():
        if file is not None:
            check_file_path(Path(text_of(file, name)))
    if (video := files["video"]) is not None:
        from kinfeas.viz.film import film_suffix

        film_suffix(Path(video))


def write_files(  # noqa: PLR0913 - an episode and its files
    replay: "EpisodeReplay",
    robot: Robot,
    picture: Name | None = None,
    video: Name | None = None,
    html: Name | None = None,
    *,
    title: str | None = None,
    on_progress: OnProgress | None = None,
) -> None:
    """Write an episode as picture, video and page; `title` is that of the picture."""
    count = counter(on_progress, "drawing")
    if picture is not None:
        from kinfeas.viz.episodes import episodes_figure
        from kinfeas.viz.style import png

        titles = None if title is None else [title]
        figure = episodes_figure(robot, [replay.recording], titles)
        write_file(Path(picture), png(figure, dpi=110))
    if video is not None:
        from kinfeas.viz.film import write_film

        write_film(replay, Path(video), count)
    if html is not None:
        from kinfeas.viz.pages import replay_html  # needs viser

        write_file(Path(html), replay_html(replay).encode())


def _draw_scene(scene: Scene, picture: Name | None, html: Name | None) -> None:
    from kinfeas.viz.drawing import scene_figure
    from kinfeas.viz.style import png

    if picture is not None:
        write_file(Path(picture), png(scene_figure(scene), dpi=110))
    if html is not None:
        from kinfeas.viz.pages import scene_html

        write_file(Path(html), scene_html(scene).encode())


def _run_facts(run: Record) -> dict[str, Any]:
    from pydantic_core import to_jsonable_python

    periods, events = run.time[1:] - run.time[:-1], zip(run.time.tolist(), run.event, strict=True)
    about = to_jsonable_python(run.about, inf_nan_mode="strings")
    keys = (
        "robot", "task", "policy", "backend", "started", "seed", "adapters", "filters",
        "generators", "guards",
    )  # fmt: skip
    return {
        **{key: about[key] for key in keys},
        "seconds": float(run.time[-1] - run.time[0]),
        "steps": int((periods > 0.5 * run.about.dt).sum()),  # the last line is no step
        "control_period_s": run.about.dt,
        "failures": int((~run.feasible).sum()),
        "top_speed_m_s": float((run.base_twist[:, :2] ** 2).sum(axis=1).max() ** 0.5),
        "longest_period_s": float(max(periods, default=0.0)),
        "events": [{"time_s": time, "event": event} for time, event in events if event],
    }


def _scene_facts(scene: Scene) -> dict[str, object]:
    objects = {
        name: {
            "urdf": str(entry.urdf_path), "pose": entry.pose.tolist(), "fixed": entry.fixed,
            "mass_kg": entry.mass, "joint_positions": entry.joint_positions,
        }
        for name, entry in scene.objects.items()
    }  # fmt: skip
    handles = {
        name: {**vars(handle), "pose": scene.handle_pose(name).tolist()}
        for name, handle in scene.handles.items()
    }
    return {"scene": scene.name, "size_m": scene.size, "objects": objects, "handles": handles}
