"""Base poses from which a robot reaches EE poses, or the reasons for which there are none."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from kinfeas.api import Name
from kinfeas.api.load import checked, load_robot
from kinfeas.config.quantities import Count, Position
from kinfeas.core.checks import ee_poses
from kinfeas.core.solids import Solids
from kinfeas.core.spatial import Array, planar_pose
from kinfeas.planning.reach import BasePlacer, Placement
from kinfeas.robots.robot import Robot
from kinfeas.scenes.scene import Scene, furniture_solids, read_scene, solid_names


def reach(  # noqa: PLR0913 - options of the command
    robot: Name | Robot | BasePlacer,
    poses: ArrayLike,
    *,
    scene: Name | Scene | None = None,
    solids: Solids | None = None,
    start: Sequence[float] | None = None,
    k: int = 8,
    together: bool = False,
) -> list[Placement]:
    """Return for each EE pose the best base poses that reach it, or the reason for none.

    Example: `kinfeas.reach("pr2", [[2, 1, 0.8, 0, 0, 0, 1]])[0].base_pose`

    Args:
        robot: Name, folder or loaded robot. A `BasePlacer` of `kinfeas.planning.reach` answers
            many calls sooner.
        poses: World poses of the EE, shape (n, 7).
        scene: Scene, or its name or YAML file, whose furniture base and arm avoid.
        solids: Other solids, in the world, one row.
        start: x, y and yaw of the base, metres and radians, from which base poses must be
            connected among solids.
        k: Largest number of base poses for each EE pose.
        together: Whether the base stands still: base poses reach all EE poses, and the list has one
            element.

    Raises:
        KinfeasError: If an argument is invalid.
    """
    placer = robot if isinstance(robot, BasePlacer) else BasePlacer(load_robot(robot))
    goals, count = ee_poses(poses, "poses"), checked(Count, k, "k")
    around, names = solids_of(scene, solids)
    where = around, None if start is None else base_pose(start, "start"), count
    if together:
        placements = [placer.place_for_all(goals, *where)]
    else:
        placements = [placer.place(goal, *where) for goal in goals]
    return [placement.named(names) for placement in placements]


def facts(placement: Placement) -> dict[str, object]:
    """Return base poses, arms, margins and the reason as plain data."""
    arrays = ("base_pose", "joint_positions", "margin", "joint_margin", "manipulability")
    return {
        "reachable": placement.reachable, "limit": placement.limit, "reason": placement.reason,
        "solids": list(placement.solids),
        **{name: getattr(placement, name).tolist() for name in (*arrays, "clearance")},
    }  # fmt: skip


def base_pose(planar: Sequence[float], name: str) -> Array:
    """Return the pose, shape (7,), of x, y and yaw, metres and radians; or raise an error."""
    return planar_pose(*np.array(checked(Position, planar, name)))


def solids_of(scene: Name | Scene | None, solids: Solids | None) -> tuple[Solids | None, list[str]]:
    """Return one row of solids, the furniture of a scene first, and their names; None for none."""
    if scene is None:
        return solids, [f"solid {k}" for k in range(0 if solids is None else solids.places)]
    layout = scene if isinstance(scene, Scene) else read_scene(str(scene))
    furniture, names = furniture_solids(layout), solid_names(layout)
    if solids is None:
        return furniture, names
    tables = np.concatenate([furniture.table, solids.table])
    return Solids.from_table(tables), names + [f"solid {k}" for k in range(len(solids.table))]


def reach_map(
    robot: Name,
    pose: ArrayLike,
    *,
    scene: Name | Scene | None = None,
    solids: Solids | None = None,
    start: Sequence[float] | None = None,
) -> bytes:
    """Return a picture of all base poses that reach an EE pose, from above, as a PNG file.

    Arguments are those of `reach`.
    """
    from kinfeas.viz.episodes import reach_figure
    from kinfeas.viz.style import png

    model, around = load_robot(robot), solids_of(scene, solids)[0]
    goal, origin = ee_poses(pose, "pose")[0], None if start is None else base_pose(start, "start")
    placer, where = BasePlacer(model), (goal, around, origin)
    return png(reach_figure(model, goal, placer.place(*where), placer.region(*where), around))
