"""`kinfeas view`: what stands in a scene, as a table, a picture or a page to turn about."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from kinfeas.cli import options
from kinfeas.cli.output import check_json_path, print_table, status, write_json

if TYPE_CHECKING:
    from kinfeas.scenes.objects import SceneObject
    from kinfeas.scenes.scene import Scene
    from kinfeas.spatial import Array


def view(
    scene: Annotated[
        str, typer.Option("--scene", help="Scene by name (room) or path of its YAML.")
    ] = "room",
    overrides: options.Overrides = None,
    json: options.JsonPath = None,
    picture: Annotated[
        Path | None,
        typer.Option("--picture", help="Draw the scene into this PNG.", callback=check_json_path),
    ] = None,
    html: Annotated[
        Path | None,
        typer.Option(
            "--html",
            help="Write a page in which to turn the scene about, its doors opening and closing.",
            callback=check_json_path,
        ),
    ] = None,
    live: Annotated[
        bool,
        typer.Option("--live", help="Serve such a page with sliders on this machine, to Ctrl-C."),
    ] = False,
) -> None:
    """Check a scene and show what stands in it."""
    from kinfeas.scenes.scene import read_scene

    found = read_scene(scene, overrides or ())
    if json is not None:
        write_json(_facts(found), json)
    if picture is not None:
        with status("drawing"):
            _draw(found, picture)
    if html is not None:
        with status("drawing"):
            _write_page(found, html)
    _show(found)
    if live:
        _serve(found)


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
    from kinfeas.evaluation.pictures import png
    from kinfeas.evaluation.scene_picture import scene_figure
    from kinfeas.folders import writing

    figure = scene_figure(scene)
    with writing(path):
        path.write_bytes(png(figure, dpi=110))


def _write_page(scene: "Scene", path: Path) -> None:
    from kinfeas.evaluation.scene_page import ScenePage
    from kinfeas.folders import writing

    page = ScenePage(scene)
    try:
        with writing(path):
            path.write_text(page.html(), encoding="utf-8")
    finally:
        page.close()


def _serve(scene: "Scene") -> None:
    from threading import Event

    from kinfeas.evaluation.scene_page import ScenePage

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
