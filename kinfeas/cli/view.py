"""`kinfeas view` and `kinfeas play`: scenes, recorded runs and simulated robots to look at."""

from contextlib import closing
from pathlib import Path

import typer

from kinfeas.cli import options
from kinfeas.cli.options import option
from kinfeas.cli.output import print_facts, print_paths, progress, write_json
from kinfeas.core.extras import require


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
    print_paths(picture, video, html, json)


def play(  # noqa: PLR0913, PLR0917 - each option is an argument
    policy: options.PolicyArgument = "pretrained",
    robot: options.PolicyRobotName = None,
    second_policy: str = option("none", "Policy of a second robot."),
    generator: str = option("servo", "Motion generator."),
    filters: str = option("time_scaling", "Command filters with commas, or none."),
    backend: str = option("analytic", "analytic, pybullet or mujoco."),
    scene: str = option("room", "Scene by name or YAML file, or none."),
    demonstrations: Path = option(Path("demonstrations"), "Folder of recorded motions."),
    host: str = option("127.0.0.1", "Address; 0.0.0.0 for other computers."),
    port: int = option(8080, "Port; 0 for a free one.", min=0, max=65535),
) -> None:
    """Drag the EE target of a simulated robot in the browser.

    Example: kinfeas play --robot pr2 --backend mujoco
    """
    require("viser")
    from kinfeas.api.load import filter_names, load_policy, robot_of
    from kinfeas.config import registry
    from kinfeas.scenes.scene import read_scene
    from kinfeas.viz.server import serving

    names, robot = filter_names(filters), robot or robot_of(policy)
    # Plugins are loaded here, so that errors are printed before the address.
    for each in {policy, second_policy} - {"none"}:
        load_policy(each, robot=robot)
    registry.load("kinfeas.motion_generators", generator)
    registry.load("kinfeas.backends", backend)
    for name in names:
        registry.load("kinfeas.filters", name)
    if scene != "none":
        read_scene(scene)
    with serving("kinfeas play", host, port) as server:
        typer.echo(server.url)  # browsers load while the rest is imported
        from kinfeas.viz.play import Choice, PlayPage

        choice = Choice(robot, policy, second_policy, generator, names, backend, scene)
        with closing(PlayPage(server, choice, demonstrations)) as page:
            page.start()
            page.run()
