"""`kinfeas view`: a scene or a recorded run as a table, a picture or an interactive page."""

from pathlib import Path

from kinfeas.cli import options
from kinfeas.cli.options import option
from kinfeas.cli.output import print_facts, print_paths, progress, write_json


def view(  # noqa: PLR0913, PLR0917 - each option is an argument
    scene: str | None = option(None, "Scene by name or YAML file.  [default: room]"),
    record: Path | None = option(None, "Record of kinfeas deploy.", metavar="FILE.csv"),
    overrides: options.Overrides = None,
    json: options.JsonPath = None,
    picture: options.Picture = None,
    video: options.Video = None,
    html: Path | None = options.file_option(None, "Write an interactive page.", ".html", ".htm"),
) -> None:
    """Show a scene, by default room; with --record a recorded run.

    Settings: every key of the scene, such as objects.box.position=[1,0,0.115].

    Example: kinfeas view --record runs/deploy/FILE.csv --picture run.png --html run.html
    """
    from kinfeas.api import view as api

    with progress() as on_progress:
        facts = api.view(
            scene, record=record, settings=options.read_settings(overrides), picture=picture,
            video=video, html=html, on_progress=on_progress,
        )  # fmt: skip
    write_json(facts, json)
    print_facts(f"record {record}" if record else f"scene {facts['scene']}", facts)
    print_paths(picture, video, html)
