"""Maps of base poses that reach an EE pose, drawn by matplotlib."""

import numpy as np
from matplotlib import rc_context
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from kinfeas.core.solids import Solids
from kinfeas.core.spatial import Array, rotation, yaw
from kinfeas.planning.reach import Placement
from kinfeas.robots.robot import Robot
from kinfeas.viz import shapes
from kinfeas.viz.episodes import draw_outline
from kinfeas.viz.style import BODY, GOAL, INK, STYLE

_APPROACH = 0.2  # m, length of the line that shows the x axis of the EE


def reach_figure(robot: Robot, goal: Array, placement: Placement, solids: Solids | None) -> Figure:
    """Return a picture from above of base poses, coloured by margin, with the best robot.

    Args:
        robot: The robot.
        goal: World pose of the EE, shape (7,).
        placement: Base poses that reach it.
        solids: In the world, one row.
    """
    with rc_context(STYLE):
        figure = Figure(figsize=(7.0, 6.0), layout="constrained")
        axes = figure.add_subplot()
        for solid in shapes.solid_shapes(solids).values():
            draw_outline(axes, shapes.corners([solid]), (*to_rgb(solid.colour[:7]), 0.75), 1.8)
        if placement.reachable:
            best = placement.base_pose[0], placement.joint_positions[0]
            for solid in shapes.robot_solids(robot, *best):
                draw_outline(axes, shapes.corners([solid]), (*to_rgb(BODY), 0.4), 2.0)
            base, heading = placement.base_pose[::-1], yaw(placement.base_pose[::-1])
            arrows = axes.quiver(
                base[:, 0], base[:, 1], np.cos(heading), np.sin(heading), placement.margin[::-1],
                angles="xy", units="inches", scale_units="inches", scale=5.0, width=0.022,
                cmap="viridis", zorder=4,
            )  # fmt: skip
            figure.colorbar(arrows, label="margin of the base pose", shrink=0.8)
        approach = _APPROACH * rotation(goal).as_matrix()[:2, 0]
        axes.plot(*np.stack([goal[:2], goal[:2] + approach]).T, color=GOAL, lw=3.0, zorder=6)
        axes.plot(*goal[:2], "*", color=GOAL, mec=INK, mew=0.7, ms=16.0, zorder=7)
        middle, half = goal[:2], 1.6
        axes.set(xlim=(middle[0] - half, middle[0] + half), xlabel="x (m)", ylabel="y (m)")
        axes.set(ylim=(middle[1] - half, middle[1] + half), aspect="equal")
        count = (
            f"{len(placement.base_pose)} base poses reach" if placement.reachable else "none for"
        )
        axes.set_title(f"{robot.name}: {count} the EE pose at a height of {goal[2]:.2f} m")
    return figure
