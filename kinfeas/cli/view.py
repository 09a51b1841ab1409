"""`kinfeas view`: a scene or a recorded run as a table, a picture or an interactive page."""

from json import dumps, loads
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from kinfeas.cli import options
from kinfeas.cli.output import print_facts, write_drawing, write_json, write_video
from kinfeas.core.errors import KinfeasError

if TYPE_CHECKING:
    from kinfeas.io.run_log import About, Record
    from kinfeas.scenes.scene import Scene


def view(  # noqa: PLR0913, PLR0917 - each option is an argument
    scene: Annotated[
        str | None, typer.Option(help="Scene by name or YAML file.  [default: room]")
    ] = None,
    record: Annotated[
        Path | None, typer.Option(metavar="FILE.csv", help="Record of kinfeas deploy.")
    ] = None,
    overrides: options.Overrides = None,
    json: options.JsonPath = None,
    picture: options.Picture = None,
    video: options.Video = None,
    html: Annotated[
        Path | None, options.file_option("Write an interactive page.", ".html", ".htm")
    ] = None,
) -> None:
    """Show a scene or a recorded run.

    Settings: every key of the scene, such as objects.box.position=[1,0,0.115].

    Example: kinfeas view --record runs/deploy/FILE.csv --picture run.png --html run.html
    """
    if record is None and video is not None:
        raise KinfeasError("--video needs --record")
    if record is None:
        _view_scene(scene or "room", overrides or [], json, picture, html)
    elif scene is not None or overrides:
        raise KinfeasError("--record excludes --scene and --set")
    else:
        _view_run(record, json, picture, video, html)


def _view_run(
    path: Path, json: Path | None, picture: Path | None, video: Path | None, html: Path | None
) -> None:
    from kinfeas.io.run_log import read_record

    run = read_record(path)
    robot = options.read_robot(run.about.robot)
    facts = _run_facts(run)
    write_json(facts, json)
    print_facts(f"record {path}", facts)
    if picture is None and video is None and html is None:
        return
    from kinfeas.viz.episodes import record_figure
    from kinfeas.viz.replay import as_recording, replay_of
    from kinfeas.viz.style import png

    write_drawing(lambda: png(record_figure(run, robot), dpi=110), picture)
    shown = replay_of(as_recording(run, robot), robot, robot.name, run.time)
    write_video(shown, video)
    if html is not None:
        from kinfeas.viz.pages import replay_html

        write_drawing(lambda: replay_html(shown).encode(), html)


def _run_facts(run: "Record") -> dict[str, object]:
    about, periods = run.about, run.time[1:] - run.time[:-1]
    events = [
        {"time_s": float(time), "event": event}
        for time, event in zip(run.time, run.event, strict=True)
        if event
    ]
    return {
        "robot": about.robot,
        "task": about.task,
        "policy": about.policy,
        "backend": about.backend,
        "started": about.started,
        **loads(dumps(_settings(about)), parse_constant=str),
        "seconds": float(run.time[-1] - run.time[0]),
        "steps": int((periods > 0.5 * about.dt).sum()),  # the end is no step
        "control_period_s": about.dt,
        "failures": int((~run.feasible).sum()),
        "top_speed_m_s": float((run.base_twist[:, :2] ** 2).sum(axis=1).max() ** 0.5),
        "longest_period_s": float(max(periods, default=0.0)),
        "events": events,
    }


def _settings(about: "About") -> dict[str, object]:
    """Return how a run was made, as in YAML."""
    return {
        "seed": about.seed,
        "adapters": [{"name": one.name, **one.parameters} for one in about.adapters],
        "filters": [{"name": one.name, **one.parameters} for one in about.filters],
        "generators": [{"name": one.name, **one.parameters} for one in about.generators],
        "guards": about.guards,
    }


def _view_scene(
    name: str, overrides: list[str], json: Path | None, picture: Path | None, html: Path | None
) -> None:
    from kinfeas.scenes.scene import read_scene
    from kinfeas.viz.figures import scene_figure
    from kinfeas.viz.style import png

    scene = read_scene(name, overrides)
    facts = _scene_facts(scene)
    write_json(facts, json)
    print_facts(f"scene {scene.name}", facts)
    write_drawing(lambda: png(scene_figure(scene), dpi=110), picture)
    if html is not None:
        from kinfeas.viz.pages import scene_html

        write_drawing(lambda: scene_html(scene).encode(), html)


def _scene_facts(scene: "Scene") -> dict[str, object]:
    objects = {
        name: {
            "urdf": str(one.urdf_path),
            "pose": one.pose.tolist(),
            "fixed": one.fixed,
            "mass_kg": one.mass,
            "joint_positions": one.joint_positions,
        }
        for name, one in scene.objects.items()
    }
    handles = {
        name: {
            "object": handle.object,
            "link": handle.link,
            "joint": handle.joint,
            "pose": scene.handle_pose(name).tolist(),
        }
        for name, handle in scene.handles.items()
    }
    return {"scene": scene.name, "size_m": scene.size, "objects": objects, "handles": handles}
