"""`kinfeas plan`: base and arm along an EE path."""

from pathlib import Path

from kinfeas.cli import options
from kinfeas.cli.options import file_option, option
from kinfeas.cli.output import print_facts, print_paths, status, write_json
from kinfeas.cli.reach import START, Planar
from kinfeas.io.files import check_new


def plan(  # noqa: PLR0913, PLR0917 - each option is an argument
    robot: options.RobotName = "pr2",
    path: Path = option(..., "EE poses, as of the generator waypoints.", metavar="FILE"),
    out: Path = file_option(..., "New file of the plan.", ".csv"),
    scene: str | None = option(None, "Scene by name or YAML file, whose furniture is avoided."),
    start: Planar | None = option(
        None,
        f"{START} The arm is at home.  [default: a base pose near the path]",
        metavar="X Y YAW",
    ),
    overrides: options.Overrides = None,
    json: options.JsonPath = None,
    picture: options.Picture = None,
    html: Path | None = file_option(None, "Write an interactive page.", ".html", ".htm"),
) -> None:
    """Plan base and arm along an EE path, within velocity limits and free of furniture.

    kinfeas deploy --plan carries it out. Settings: parameters of the generator waypoints, such as
    max_velocity. Without a plan the error names the EE pose that is out of reach, with the reason.

    Example: kinfeas plan --robot pr2 --path ee.csv --scene room --out plan.csv --html plan.html
    """
    from kinfeas.api.plan import plan as api
    from kinfeas.core.spatial import distance

    check_new(out)
    settings = options.read_settings(overrides)
    with status("planning"):
        planned = api(robot, path, start=start, scene=scene, settings=settings)
    planned.save(out)
    base, joints = planned.base[0], planned.joint_positions[0]
    facts = {
        "seconds": float(planned.time[-1]), "moments": len(planned.time),
        "ee_error_m": float(distance(planned.reached, planned.ee_pose)[0].max()),
        "start": base.tolist(),
        "start_joints": dict(zip(planned.joint_names, joints.tolist(), strict=True)),
    }  # fmt: skip
    write_json(
        {**facts, "joint_trajectory": planned.joint_trajectory(), "base_path": planned.base_path()},
        json,
    )
    print_facts(f"plan of {robot} along {path}", facts)
    with status("drawing"):
        if picture is not None:
            planned.picture(picture)
        if html is not None:
            planned.html(html)
    print_paths(out, picture, html)
