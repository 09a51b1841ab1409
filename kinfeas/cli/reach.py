"""`kinfeas reach`: base poses from which a robot reaches EE poses, or the reason for none."""

from pathlib import Path

import typer

from kinfeas.cli import options
from kinfeas.cli.options import option
from kinfeas.cli.output import print_table, status, write_drawing, write_json
from kinfeas.core.errors import KinfeasError

Pose = tuple[float, float, float, float, float, float]
Planar = tuple[float, float, float]
_COLUMNS = [" x, m", " y, m", " yaw, rad", " margin", " joints", " manip.", " clear, m"]
START = "Base pose now: m, m, rad."


def reach(  # noqa: PLR0913, PLR0917 - each option is an argument
    robot: options.RobotName = "pr2",
    pose: Pose | None = option(
        None, "EE pose in the world frame: m, rad.", metavar="X Y Z ROLL PITCH YAW"
    ),
    poses: Path | None = option(None, "EE poses, as of the generator waypoints.", metavar="FILE"),
    scene: str | None = option(None, "Scene by name or YAML file, whose furniture is avoided."),
    start: Planar | None = option(None, START, metavar="X Y YAW"),
    count: int = option(8, "Most base poses for each EE pose.", "-k", min=1, max=512),
    together: bool = option(False, "One base pose for all EE poses.", "--together"),
    json: options.JsonPath = None,
    picture: options.Picture = None,
) -> None:
    """Find base poses from which the EE reaches poses, or the reason why there are none.

    The margin, 0 to 1, is the least of three: distance to joint limits, manipulability, and
    distance to solids up to 0.1 m. Base poses must be connected to the start, if it is given. The
    picture is of the first EE pose.

    Example: kinfeas reach --robot pr2 --pose 1.6 0.4 0.8 0 0 0 --scene room --picture reach.png
    """
    from kinfeas.api.reach import facts, reach_map
    from kinfeas.api.reach import reach as api
    from kinfeas.core.spatial import yaw
    from kinfeas.plugins.waypoints import read_waypoints

    if (pose is None) == (poses is None):
        raise KinfeasError("give --pose or --poses")
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
