"""`kinfeas view`: a scene or a recorded run, as a table, a picture or a page to turn about."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from kinfeas.cli import inputs, options
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
    from kinfeas.core.spatial import Array
    from kinfeas.io.run_log import Record
    from kinfeas.robots.robot import Robot
    from kinfeas.scenes.objects import SceneObject
    from kinfeas.scenes.scene import Scene


def view(  # noqa: PLR0913, PLR0917 - each option is an argument
    scene: Annotated[
        str | None,
        typer.Option("--scene", help="Scene by name or path of its YAML; by default room."),
    ] = None,
    record: Annotated[
        Path | None,
        typer.Option(
            "--record",
            metavar="FILE.csv",
            help="Replay a run that kinfeas deploy recorded, instead.",
        ),
    ] = None,
    overrides: options.Overrides = None,
    json: options.JsonPath = None,
    picture: Annotated[
        Path | None,
        typer.Option("--picture", help="Draw it into this PNG.", callback=check_file_path),
    ] = None,
    html: Annotated[
        Path | None,
        typer.Option(
            "--html",
            help="Write a page in which to turn it about: the run as it went, or the scene with "
            "its doors opening and closing.",
            callback=check_file_path,
        ),
    ] = None,
    live: Annotated[
        bool,
        typer.Option(
            "--live", help="Serve a scene's page with sliders on this machine, to Ctrl-C."
        ),
    ] = False,
) -> None:
    """Check a scene and show what stands in it, or replay a recorded run.

    Settings: every key of the scene, such as [bold]objects.box.position=[1,0,0.115][/].
    """
    sources = {"--scene": inputs.named(scene), "--record": inputs.named(record)}
    sources["--set"] = inputs.of_settings(overrides)
    check_outputs({"--json": json, "--picture": picture, "--html": html}, sources)
    if record is not None:
        given = {"--scene": scene, "--set": overrides, "--live": live or None}
        for name, value in given.items():
            if value is not None:
                raise KinfeasError(f"{name} and --record exclude each other")
        _replay(record, json, picture, html)
        return
    from kinfeas.scenes.scene import read_scene

    found = read_scene("room" if scene is None else scene, overrides or ())
    if json is not None:
        write_json(_facts(found), json)
    if picture is not None:
        with status("drawing"):
            _draw(found, picture)
    if html is not None:
        with status("drawing"):
            _write_page(found, html)
    _show(found)
    say_written(picture, html)
    if live:
        _serve(found)


def _replay(path: Path, json: Path | None, picture: Path | None, html: Path | None) -> None:
    from kinfeas.io.run_log import read_record

    run = read_record(path)
    robot = options.read_robot(run.about.robot)
    if json is not None:
        write_json(_run_facts(run), json)
    if picture is not None:
        with status("drawing"):
            _draw_run(run, robot, picture)
    if html is not None:
        with status("drawing"):
            _write_run_page(run, robot, html)
    _show_run(run)
    say_written(picture, html)


def _draw_run(run: "Record", robot: "Robot", path: Path) -> None:
    from kinfeas.io.files import write_file
    from kinfeas.viz.episodes import record_figure
    from kinfeas.viz.style import png

    write_file(path, png(record_figure(run, robot), dpi=110))


def _write_run_page(run: "Record", robot: "Robot", path: Path) -> None:
    from kinfeas.io.files import write_file
    from kinfeas.viz.episodes import as_recording, scene_of
    from kinfeas.viz.pages import episode_html

    write_file(
        path, episode_html(as_recording(run, robot), robot, run.time, scene_of(run)).encode()
    )


def _run_facts(run: "Record") -> dict[str, object]:
    """Return what a record says of the whole run."""
    about, steps = run.about, run.time[1:] - run.time[:-1]
    speed = (run.base_twist[:, :2] ** 2).sum(axis=1) ** 0.5
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
        "seconds": float(run.time[-1] - run.time[0]),
        "steps": len(steps),
        "control_period_s": about.dt,
        "failures": int((~run.feasible).sum()),
        "top_speed_m_s": float(speed.max()),
        "longest_period_s": float(max(steps, default=0.0)),
        "events": events,
    }


def _show_run(run: "Record") -> None:
    facts = _run_facts(run)
    title = "{policy} on {task}, robot {robot}, {backend}, {started}".format(**facts)
    rows = [
        ["duration", f"{facts['seconds']:.1f} s"],
        ["control period", f"{1000.0 * run.about.dt:.1f} ms"],
        ["longest", f"{1000.0 * float(str(facts['longest_period_s'])):.1f} ms"],
        ["control periods without an IK solution", f"{facts['failures']}"],
        ["top speed commanded", f"{facts['top_speed_m_s']:.2f} m/s"],
    ]
    print_table(title, ["", " "], rows)
    noted = [[f"{t:.2f} s", text] for t, text in zip(run.time, run.event, strict=True) if text]
    if not run.event[-1]:
        noted.append([f"{run.time[-1]:.2f} s", "the record breaks off here"])
    print_table("events", [" at", "event"], noted)


def _facts(scene: "Scene") -> dict[str, object]:
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


def _draw(scene: "Scene", path: Path) -> None:
    from kinfeas.io.files import write_file
    from kinfeas.viz.figures import scene_figure
    from kinfeas.viz.style import png

    write_file(path, png(scene_figure(scene), dpi=110))


def _write_page(scene: "Scene", path: Path) -> None:
    from kinfeas.io.files import write_file
    from kinfeas.viz.pages import ScenePage

    page = ScenePage(scene)
    try:
        write_file(path, page.html().encode())
    finally:
        page.close()


def _serve(scene: "Scene") -> None:
    from threading import Event

    from kinfeas.viz.pages import ScenePage

    page = ScenePage(scene)
    page.add_sliders()
    typer.echo(f"open {page.address} in a browser; Ctrl-C ends it")
    try:
        Event().wait()
    finally:
        page.close()


def _show(scene: "Scene") -> None:
    objects = [
        [name, _place(one.pose), "" if one.fixed else "yes", f"{one.mass:g} kg", _joints(one)]
        for name, one in scene.objects.items()
    ]
    title = f"scene {scene.name}, {scene.size[0]:g} x {scene.size[1]:g} m"
    print_table(title, ["object", " at (m)", "can be moved", " mass", "joints"], objects)
    handles = [
        [
            name,
            f"{handle.object}, {handle.link}",
            _place(scene.handle_pose(name)),
            handle.joint or "",
        ]
        for name, handle in scene.handles.items()
    ]
    if handles:
        print_table("handles", ["handle", "on", " at (m)", "moves"], handles)


def _place(pose: "Array") -> str:
    return ", ".join(f"{round(value, 3) + 0.0:g}" for value in pose[:3])


def _joints(one: "SceneObject") -> str:
    joints = (one.urdf.joints[name] for name in one.joint_positions)
    return ", ".join(f"{joint.name} {joint.lower:g} to {joint.upper:g}" for joint in joints)
