"""Base poses from which a robot reaches EE poses, or the reasons for which there are none."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from kinfeas.api import Name
from kinfeas.api.load import checked, load_robot
from kinfeas.control.execution import tool_pose
from kinfeas.core.checks import ee_poses
from kinfeas.core.errors import KinfeasError
from kinfeas.core.quantities import Count, Position
from kinfeas.core.solids import Solids
from kinfeas.core.spatial import Array, compose, planar_pose
from kinfeas.kinematics.solids import base_collides
from kinfeas.planning.reach import BasePlacer, Placement
from kinfeas.plugins.waypoints import read_waypoints
from kinfeas.robots.robot import Robot
from kinfeas.scenes.scene import Scene, furniture_solids, read_scene, solid_names

_GRASPED = 0.05  # distance from the tool tip within which movable objects are grasped, metres


def reach(  # noqa: PLR0913 - options of the command
    robot: Name | Robot | BasePlacer,
    poses: Name | ArrayLike,
    *,
    scene: Name | Scene | None = None,
    solids: Solids | ArrayLike | None = None,
    start: Sequence[float] | None = None,
    k: int = 8,
    together: bool = False,
) -> list[Placement]:
    """Return for each EE pose the best base poses that reach it, or the reason for none.

    Example: `kinfeas.reach("pr2", [[2, 1, 0.8, 0, 0, 0, 1]])[0].base_pose`

    Args:
        robot: Name, folder or loaded robot. With a `BasePlacer` of `kinfeas.planning.reach`,
            repeated calls are faster.
        poses: World poses of the EE, shape (n, 7), or a file of them, as for the generator
            `waypoints`.
        scene: Scene, or its name or YAML file. Base and arm avoid its objects, except movable ones
            within 5 cm of the tool tip at the EE pose: these count as grasped.
        solids: Other solids in the world: one row of `kinfeas.core.solids.Solids`, or a table of
            shape (m, 11).
        start: Current x, y and yaw of the base, metres and radians. The base must be free of solids
            there, and able to drive from there to the base poses.
        k: Largest number of base poses for each EE pose.
        together: Whether the base stands still: each base pose reaches all EE poses, and the list
            has one element.

    Raises:
        KinfeasError: If an argument is invalid.
    """
    numbers = read_waypoints(Path(poses))[0] if isinstance(poses, str | Path) else poses
    goals, count = ee_poses(numbers, "poses"), checked(Count, k, "k")
    together = checked(bool, together, "together")
    origin = None if start is None else base_pose(start, "start")
    placer = placer_of(robot)
    layout = _scene_of(scene)
    every = solids_of(layout, solids)
    queries = [goals] if together else list(goals[:, np.newaxis])
    placements = []
    for query in queries:
        tips = compose(query, tool_pose(placer.solver.robot))
        around, names = _not_grasped(layout, *every, tips)
        _check_start(placer, origin, around, names)
        find = placer.place_for_all if together else placer.place
        placement = find(query if together else query[0], around, origin, count)
        placements.append(placement.named(names))
    return placements


def placer_of(robot: Name | Robot | BasePlacer) -> BasePlacer:
    """Return the placer of a robot; a placer is returned unchanged."""
    return robot if isinstance(robot, BasePlacer) else BasePlacer(load_robot(robot))


def _check_start(
    placer: BasePlacer, origin: Array | None, around: Solids | None, names: Sequence[str]
) -> None:
    """Raise KinfeasError if the base touches a solid at its start, a pose (7,)."""
    if origin is None or around is None:
        return
    start_pose, collision = origin[np.newaxis], placer.solver.collision
    if base_collides(collision, start_pose, around)[0]:
        singles = (around.only(np.array([index])) for index in range(around.places))
        touched = [base_collides(collision, start_pose, solid)[0] for solid in singles]
        raise KinfeasError(f"at the 'start' the base touches {names[touched.index(True)]}")


def facts(placement: Placement) -> dict[str, object]:
    """Return a placement as plain data: base poses, arm joints, margins and the reason."""
    arrays = ("base_pose", "joint_positions", "margin", "joint_margin", "manipulability")
    return {
        "reachable": placement.reachable, "limit": placement.limit, "reason": placement.reason,
        "solids": list(placement.solids),
        **{name: getattr(placement, name).tolist() for name in (*arrays, "clearance")},
    }  # fmt: skip


def base_pose(planar: Sequence[float], name: str) -> Array:
    """Return the pose, shape (7,), of x, y and yaw, metres and radians; or raise an error."""
    return planar_pose(*np.array(checked(Position, planar, name)))


def solids_of(
    scene: Name | Scene | None, solids: Solids | ArrayLike | None, tips: Array | None = None
) -> tuple[Solids | None, list[str]]:
    """Return one row of solids, the objects of a scene first, or None; and their names.

    Movable objects near `tips`, poses of the tool tip of shape (n, 7), are grasped and left out.
    """
    if solids is not None and not isinstance(solids, Solids):
        solids = Solids.from_table(solids)
    if solids is not None and len(solids.size) != 1:
        raise KinfeasError(f"'solids' must be one row of `Solids`, not {len(solids.size)}")
    names = [f"solid {k}" for k in range(0 if solids is None else solids.places)]
    layout = _scene_of(scene)
    if layout is None:
        return solids, names
    objects, names = furniture_solids(layout, movable=True), solid_names(layout) + names
    around = objects if solids is None else objects.joined(solids)
    return (around, names) if tips is None else _not_grasped(layout, around, names, tips)


def _not_grasped(
    scene: Scene | None, around: Solids | None, names: list[str], tips: Array
) -> tuple[Solids | None, list[str]]:
    """Return solids and their names without the objects grasped at `tips`, as `solids_of`."""
    if scene is None or around is None:
        return around, names
    near = np.hypot(*around.gaps(tips[np.newaxis, :, :3]))[0].min(axis=0) < _GRASPED
    movable = {name for name, entry in scene.objects.items() if not entry.fixed}
    grasped = movable & {names[k] for k in np.flatnonzero(near)}
    kept = [k for k, name in enumerate(names) if name not in grasped]
    return around.only(np.array(kept, dtype=np.intp)), [names[k] for k in kept]


def _scene_of(scene: Name | Scene | None) -> Scene | None:
    return scene if scene is None or isinstance(scene, Scene) else read_scene(str(scene))


def reach_map(
    robot: Name | Robot | BasePlacer,
    pose: ArrayLike,
    *,
    scene: Name | Scene | None = None,
    solids: Solids | ArrayLike | None = None,
    start: Sequence[float] | None = None,
) -> bytes:
    """Return a PNG file of all base poses that reach an EE pose, seen from above.

    Arguments are those of `reach`.
    """
    from kinfeas.viz.episodes import reach_figure
    from kinfeas.viz.style import png

    placer, goal = placer_of(robot), ee_poses(pose, "pose")[0]
    model = placer.solver.robot
    around, names = solids_of(scene, solids, compose(goal, tool_pose(model))[np.newaxis])
    origin = None if start is None else base_pose(start, "start")
    _check_start(placer, origin, around, names)
    where = goal, around, origin
    return png(reach_figure(model, goal, placer.place(*where), placer.region(*where), around))
