"""`kinfeas reach`, `plan` and `serve`: base poses and motions that reach EE poses, and a server."""

from contextlib import suppress
from pathlib import Path

import typer

from kinfeas.api import DEFAULT_ROBOT
from kinfeas.cli import options
from kinfeas.cli.options import file_option, option
from kinfeas.cli.output import (
    print_facts,
    print_paths,
    print_table,
    status,
    write_drawing,
    write_json,
)
from kinfeas.core.errors import KinfeasError
from kinfeas.core.files import check_new
from kinfeas.core.quantities import Vector

Pose = tuple[float, float, float, float, float, float]
_COLUMNS = [" x, m", " y, m", " yaw, rad", " margin", " joints", " manip.", " clear, m"]
START = "Base pose now: m, m, rad."


def reach(  # noqa: PLR0913, PLR0917 - each option is an argument
    robot: options.RobotName = DEFAULT_ROBOT,
    pose: Pose | None = option(
        None, "EE pose in the world frame: m, rad.", metavar="X Y Z ROLL PITCH YAW"
    ),
    poses: Path | None = option(None, "EE poses, as of the generator waypoints.", metavar="FILE"),
    scene: str | None = option(None, "Scene by name or YAML file, whose objects are avoided."),
    start: Vector | None = option(None, START, metavar="X Y YAW"),
    count: int = option(8, "Most base poses for each EE pose.", "-k", min=1, max=512),
    together: bool = option(False, "One base pose for all EE poses.", "--together"),
    json: options.JsonPath = None,
    picture: options.Picture = None,
) -> None:
    """Find base poses that reach EE poses, or the reason for none.

    The margin, 0 to 1, is the least of three: distance to joint limits, manipulability, and
    distance to solids up to 0.1 m. Base poses must be connected to the start, if it is given. The
    picture is of the first EE pose.

    Example: kinfeas reach --robot pr2 --pose 1.6 0.4 0.8 0 0 0 --scene room --picture reach.png
    """
    if (pose is None) == (poses is None):
        raise KinfeasError("give --pose or --poses")

    from kinfeas.api.reach import facts, reach_map
    from kinfeas.api.reach import reach as api
    from kinfeas.core.spatial import yaw
    from kinfeas.plugins.waypoints import read_waypoints

    goals = read_waypoints(poses)[0] if poses else pose_of(pose)
    with status("searching"):
        placements = api(robot, goals, scene=scene, start=start, k=count, together=together)
    write_json([facts(placement) for placement in placements], json)
    for number, placement in enumerate(placements, 1):
        name = "all poses" if together else f"pose {number} of {len(placements)}"
        text = f"{robot}, {name}: {placement.reason or 'base poses'}"
        columns = zip(
            placement.base_pose, placement.margin, placement.joint_margin,
            placement.manipulability, placement.clearance, strict=True,
        )  # fmt: skip
        rows = [
            [f"{value:.3f}" for value in (base[0], base[1], float(yaw(base)), *margins)]
            for base, *margins in columns
        ]
        if rows:
            print_table(text, _COLUMNS, rows)
        else:
            typer.echo(text)
    write_drawing(lambda: reach_map(robot, goals[:1], scene=scene, start=start), picture)


def pose_of(pose: Pose | None) -> list[list[float]]:
    """Return the pose x y z qx qy qz qw of x, y, z, roll, pitch and yaw, as a list of one."""
    from scipy.spatial.transform import Rotation

    numbers = list(pose or ())
    return [[*numbers[:3], *Rotation.from_euler("xyz", numbers[3:]).as_quat().tolist()]]


def plan(  # noqa: PLR0913, PLR0917 - each option is an argument
    robot: options.RobotName = DEFAULT_ROBOT,
    path: Path = option(..., "EE poses, as of the generator waypoints.", metavar="FILE"),
    out: Path = file_option(..., "New file of the plan.", ".csv"),
    scene: str | None = option(None, "Scene by name or YAML file, whose objects are avoided."),
    start: Vector | None = option(
        None,
        f"{START} The arm is at home.  [default: a base pose near the path]",
        metavar="X Y YAW",
    ),
    overrides: options.Overrides = None,
    json: options.JsonPath = None,
    picture: options.Picture = None,
    html: Path | None = file_option(None, "Write an interactive page.", ".html", ".htm"),
) -> None:
    """Plan base and arm along an EE path.

    The plan keeps velocity limits and is free of objects; kinfeas deploy --plan carries it out.
    Settings: parameters of the generator waypoints, such as max_velocity. Without a plan the error
    names the EE pose that is out of reach, with the reason.

    Example: kinfeas plan --robot pr2 --path ee.csv --scene room --out plan.csv --html plan.html
    """
    check_new(out)
    settings = options.read_settings(overrides)

    from kinfeas.api.plan import plan as api
    from kinfeas.core.spatial import distance

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
    print_paths(out, picture, html, json)


def serve(
    robot: options.RobotName = DEFAULT_ROBOT,
    scene: str | None = option(None, "Scene by name or YAML file, whose objects are avoided."),
    port: int = option(8081, "Port; 0 for a free one.", min=0, max=65535),
    ros2: bool = option(False, "Also answer ROS 2 nodes on the network.", "--ros2"),
) -> None:
    """Answer POST /reach and POST /plan with JSON, until Ctrl-C.

    HTTP answers only programs on this computer.

    Example: kinfeas serve --robot pr2 --scene room
    """
    from kinfeas.api.serve import PlanningServer

    with status("preparing"):
        server = PlanningServer(robot, scene, port, ros2=ros2)
    typer.echo(server.url)
    with server, suppress(KeyboardInterrupt):
        server.serve_forever()
