"""Draw the pictures of docs/method.md: loop, observation, feasibility, reward."""

from itertools import pairwise
from pathlib import Path
from typing import Literal

import matplotlib as mpl
import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyArrowPatch, FancyBboxPatch, Polygon
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from kinfeas.control.observation import OBSERVATION, TERMS
from kinfeas.core.metrics import GOAL_METRES, GOAL_RADIANS
from kinfeas.core.spatial import Array, compose, make_pose, planar_pose, relative
from kinfeas.kinematics.ik import IkOptions, IkSolver
from kinfeas.planning.placement import reachable
from kinfeas.robots.loading import load_robot
from kinfeas.robots.robot import Robot
from kinfeas.viz.drawing import (
    add_axes,
    draw_floor,
    draw_solids,
    show_all,
)
from kinfeas.viz.shapes import corners, faces, robot_solids
from kinfeas.viz.style import ARM, BASE, BODY, DESIRED, EE, FAILURE, GOAL, INK, STYLE, TITLES, png

IMAGES = Path(__file__).parent / "images"
ROBOTS = ("pr2", "tiago", "hsr")
HEADINGS, CELLS, REACH = 24, 61, 1.2
HEIGHTS, GOALS_A_HEIGHT = np.linspace(0.1, 1.7, 17), 80

Side = Literal["left", "center", "right"]
Level = Literal["bottom", "center", "top"]


def box(axes: Axes, at: tuple[float, float], name: str, text: str, colour: str) -> None:
    """Draw a part of the loop."""
    x, y = at
    axes.add_patch(
        FancyBboxPatch(
            (x - 1.35, y - 0.45), 2.7, 0.9, boxstyle="round,pad=0.02,rounding_size=0.12",
            facecolor="white", edgecolor=colour, lw=2.0, zorder=3,
        )
    )  # fmt: skip
    axes.text(x, y + 0.16, name, ha="center", va="center", weight="bold", fontsize=11, zorder=4)
    axes.text(x, y - 0.19, text, ha="center", va="center", fontsize=8.5, color="#5a626d", zorder=4)


def arrow(axes: Axes, *way: tuple[float, float]) -> None:
    """Draw an arrow through corners."""
    for start, end in pairwise(way[:-1]):
        axes.plot(*zip(start, end, strict=True), color=INK, lw=1.5, solid_capstyle="round")
    axes.add_patch(
        FancyArrowPatch(
            way[-2], way[-1], shrinkA=0, shrinkB=0, arrowstyle="-|>", mutation_scale=14, lw=1.5,
            color=INK,
        )
    )  # fmt: skip


def note(
    axes: Axes, x: float, y: float, text: str, ha: Side = "center", va: Level = "bottom"
) -> None:
    """Write the label of an arrow."""
    axes.text(x, y, text, fontsize=9, color=INK, ha=ha, va=va)


def loop() -> Figure:
    """Return the picture of a step."""
    figure = Figure(figsize=(9.6, 3.2), layout="constrained")
    axes = figure.subplots()
    axes.set(xlim=(-1.5, 14.6), ylim=(-0.3, 4.4))
    axes.set_aspect("equal")
    axes.set_axis_off()
    box(axes, (0.0, 3.2), "Task", "goals of the EE", GOAL)
    box(axes, (4.2, 3.2), "Motion generator", "desired EE motion", EE)
    box(axes, (8.9, 3.2), "IK", "solves for the arm", ARM)
    box(axes, (8.9, 0.4), "Policy", "commands the base", BASE)
    box(axes, (13.1, 1.8), "Backend", "simulation or robot", INK)
    arrow(axes, (1.4, 3.2), (2.8, 3.2))
    note(axes, 2.1, 3.28, "goal")
    arrow(axes, (5.6, 3.2), (7.5, 3.2))
    note(axes, 6.5, 3.28, "desired pose")
    arrow(axes, (10.3, 3.2), (13.1, 3.2), (13.1, 2.3))
    note(axes, 11.7, 3.28, "joint targets")
    arrow(axes, (4.2, 2.7), (4.2, 0.4), (7.5, 0.4))
    note(axes, 4.05, 1.5, "planned motion,\ngoal", ha="right", va="center")
    arrow(axes, (10.3, 0.4), (13.1, 0.4), (13.1, 1.3))
    note(axes, 11.7, 0.48, "base velocity")
    arrow(axes, (8.4, 0.9), (8.4, 2.7))
    note(axes, 8.25, 1.8, "next base\npose", ha="right", va="center")
    arrow(axes, (11.7, 1.8), (9.6, 1.8), (9.6, 0.9))
    arrow(axes, (9.6, 1.8), (9.6, 2.7))
    note(axes, 10.65, 1.88, "measured state")
    axes.text(
        6.55, 4.2, "One control period, 0.1 s in training", ha="center", va="center", fontsize=12,
        weight="bold",
    )  # fmt: skip
    return figure


def stance(robot: Robot, ee: Array) -> tuple[Array, Array]:
    """Return a base pose and arm joints with the EE at `ee`, in front of the base."""
    solver = IkSolver(robot)
    seed = robot.home["home"][np.newaxis]
    ways = [(x, y) for y in (0.15, 0.08, 0.0, -0.08) for x in np.linspace(0.75, 0.4, 15)]
    for ahead, aside in ways:
        base = planar_pose(np.array(ee[0] - ahead), np.array(ee[1] + aside), np.array(0.0))
        found = solver.solve(relative(ee, base)[np.newaxis], seed)
        if found.feasible[0]:
            return base, found.joint_positions[0]
    raise ValueError(f"{robot.name} does not reach {ee}")


def outline(axes: Axes, robot: Robot, base: Array, joints: Array) -> None:
    """Draw the robot from above."""
    solids = robot_solids(robot, base, joints)
    body = corners([solid for solid in solids if solid.colour == BODY])[:, :2]
    hull = body[ConvexHull(body).vertices]
    axes.add_patch(Polygon(hull, facecolor=BODY, edgecolor="#9aa2ad", zorder=2))
    for solid in solids:
        for face in faces(solid.shape) if solid.colour == ARM else ():
            axes.add_patch(Polygon(face[:, :2], facecolor=ARM, edgecolor="none", zorder=2.5))


def seen() -> Figure:
    """Return the picture of an observation."""
    robot = load_robot("pr2")
    ee = make_pose(np.array([0.75, -0.15, 0.8]), Rotation.from_euler("z", 0.2))
    base, joints = stance(robot, ee)
    figure = Figure(figsize=(9.6, 4.4), layout="constrained")
    top, row = figure.subplots(2, 1, height_ratios=(3.0, 1.0))
    outline(top, robot, base, joints)
    origin, place, goal = base[:2], ee[:2], np.array([2.3, 0.75])
    for turn, name in ((0.0, "x"), (np.pi / 2.0, "y")):
        tip = origin + 0.45 * np.array([np.cos(turn), np.sin(turn)])
        top.annotate("", tip, origin, arrowprops={"arrowstyle": "-|>", "color": BASE, "lw": 2})
        top.annotate(
            name, tip, (4, 4), textcoords="offset points", color=BASE, weight="bold", zorder=6
        )
    top.annotate("base frame", origin, (-0.35, -0.55), textcoords="data", color=BASE, ha="right",
                 arrowprops={"arrowstyle": "-", "color": BASE, "lw": 0.8})  # fmt: skip
    way = np.linspace(place, goal, 50)
    top.plot(*way.T, "--", color=DESIRED, lw=1.4, zorder=1.5)
    ahead = place + 0.3 * (goal - place) / np.linalg.norm(goal - place)
    top.annotate("", ahead, place, zorder=7,
                 arrowprops={"arrowstyle": "-|>", "color": FAILURE, "lw": 2.4})  # fmt: skip
    top.plot(*place, "o", color=EE, ms=9, mec="white", zorder=8)
    top.plot(*goal, "*", color=GOAL, ms=18, mec="white", zorder=8)
    top.annotate("EE", place, (-6, -26), textcoords="offset points", color=EE, weight="bold")
    top.annotate("planned motion", ahead, (8, -10), textcoords="offset points", color=FAILURE,
                 weight="bold")  # fmt: skip
    top.annotate("goal", goal, (10, -4), textcoords="offset points", color=GOAL, weight="bold")
    top.set_aspect("equal")
    top.set(xlim=(-1.2, 2.9), ylim=(-0.75, 1.0))
    top.set_axis_off()
    colours = (EE, EE, FAILURE, FAILURE, GOAL, GOAL, ARM)
    names = ("EE\nposition", "EE\norientation", "planned\nvelocity", "planned\nrotation",
             "goal\nposition", "goal\norientation", "arm joints")  # fmt: skip
    sizes = [TERMS[name].width(robot) for name in OBSERVATION]
    first = 0.0
    for colour, name, count in zip(colours, names, sizes, strict=True):
        for cell in range(count):
            row.add_patch(Polygon(
                [(first + cell + dx, dy) for dx, dy in ((0, 0), (0.9, 0), (0.9, 1), (0, 1))],
                facecolor=colour, alpha=0.85,
            ))  # fmt: skip
        row.text(first + count / 2 - 0.05, -0.25, name, ha="center", va="top", fontsize=8.5)
        row.text(first + count / 2 - 0.05, 1.15, f"{count}", ha="center", va="bottom", fontsize=9)
        first += count + 0.5
    row.set(xlim=(-0.3, first - 0.3), ylim=(-1.6, 1.9))
    row.set_axis_off()
    return figure


def stances(robot: Robot, ee: Array) -> Array:
    """Return the share of feasible headings for an EE pose by base position, shape (x, y)."""
    solver = IkSolver(robot)
    line = np.linspace(-REACH, REACH, CELLS)
    headings = np.linspace(-np.pi, np.pi, HEADINGS, endpoint=False)
    x, y, heading = (part.ravel() for part in np.meshgrid(line, line, headings, indexing="ij"))
    base = planar_pose(x + ee[0], y + ee[1], heading)
    targets = relative(np.broadcast_to(ee, base.shape), base)
    seed = np.tile(robot.home["home"], (len(base), 1))
    feasible = solver.solve(targets, seed).feasible
    return feasible.reshape(CELLS, CELLS, HEADINGS).mean(axis=2).T


def feasible() -> Figure:
    """Return the picture of feasible base positions."""
    figure = Figure(figsize=(9.6, 5.6), layout="constrained")
    grid = figure.add_gridspec(2, 3, height_ratios=(0.75, 1.0))
    below = [figure.add_subplot(grid[1, column]) for column in range(3)]
    ee = make_pose(np.array([0.0, 0.0, 0.8]), Rotation.identity())
    for column, (name, plan) in enumerate(zip(ROBOTS, below, strict=True)):
        robot = load_robot(name)
        pose = in_gripper_convention(robot, ee)
        base, joints = stance(robot, pose)
        solids = robot_solids(robot, base, joints)
        side = add_axes(figure, grid[0, column], np.deg2rad(25.0), np.deg2rad(25.0))
        floor = draw_floor(side, corners(solids))
        draw_solids(side, solids)
        side.plot(*pose[:3, np.newaxis], "o", color=GOAL, ms=8, mec="white", zorder=6)
        show_all(side, np.concatenate([corners(solids), floor]), 1.3)
        side.set_title(TITLES[name])
        edges = np.linspace(-REACH, REACH, CELLS + 1)
        shares = stances(robot, pose)
        mesh = plan.pcolormesh(
            edges, edges, np.where(shares > 0.0, shares, np.nan), cmap="viridis_r",
            vmin=0.0, vmax=0.75, rasterized=True,
        )  # fmt: skip
        plan.add_patch(Circle((0.0, 0.0), 0.04, color=GOAL, zorder=5))
        plan.annotate("", (0.3, 0.0), (0.0, 0.0), zorder=5,
                      arrowprops={"arrowstyle": "-|>", "color": GOAL, "lw": 2})  # fmt: skip
        plan.set_aspect("equal")
        plan.set(xlabel="base x in the EE frame (m)", ylabel="base y (m)" if name == "pr2" else "")
    figure.colorbar(mesh, ax=below, label="share of headings\nwith an IK solution", shrink=0.9)
    return figure


def in_gripper_convention(robot: Robot, tip: Array) -> Array:
    """Return the EE pose at `tip` with the gripper in its orientation."""
    turn = np.concatenate([np.zeros(3), robot.gripper_rotation])
    return compose(tip, turn)


def reached(robot: Robot) -> Array:
    """Return the share of turned goals that some base pose reaches, by height, shape (h,)."""
    # The pose tolerance does not hold at goals.
    goal = IkOptions(
        pose_tolerance=False, position_tolerance=GOAL_METRES, rotation_tolerance=GOAL_RADIANS
    )
    solver = IkSolver(robot, IkOptions() if robot.pose_tolerance is None else goal)
    rng = np.random.default_rng(0)
    shares = []
    for height in HEIGHTS:
        turns = Rotation.from_euler("xyz", rng.uniform(0.0, 2.0 * np.pi, (GOALS_A_HEIGHT, 3)))
        places = np.tile([0.0, 0.0, height], (GOALS_A_HEIGHT, 1))
        shares.append(reachable(solver, make_pose(places, turns), (16, 256)).share.value)
    return np.array(shares)


def earned() -> Figure:
    """Return the picture of the reward of a failure and of reachability."""
    figure = Figure(figsize=(9.6, 3.6), layout="constrained")
    cost, ceiling = figure.subplots(1, 2, width_ratios=(0.9, 1.1))
    missing = np.linspace(0.0, 0.2, 201)
    graded = np.minimum(1.0, 0.2 + 0.4 * (missing / 0.1) ** 2)
    cost.plot(100 * missing, -graded, color=EE, lw=2.4, label="graded (default)")
    cost.plot([0.0, 20.0], [-1.0, -1.0], "--", color=FAILURE, lw=2.0, label="paper")
    cost.plot([0.0], [0.0], "o", color=INK, ms=7)
    cost.annotate("feasible", (0.0, 0.0), (8, -3), textcoords="offset points")
    cost.set(xlabel="remaining distance to the desired pose (cm)", ylabel="reward",
             ylim=(-1.12, 0.1))  # fmt: skip
    cost.set_title("Reward of an IK failure")
    cost.legend(loc="lower left", bbox_to_anchor=(0.0, 0.12))
    for name, colour in zip(ROBOTS, (BASE, GOAL, EE), strict=True):
        robot = load_robot(name)
        ceiling.plot(HEIGHTS, 100 * reached(robot), "o-", color=colour, ms=4, lw=2.0,
                     label=TITLES[name])  # fmt: skip
        low, high = robot.reach.low, robot.reach.high
        place = -6.0 - 5.0 * ROBOTS.index(name)
        ceiling.plot([low, high], [place, place], color=colour, lw=4, solid_capstyle="butt")
    ceiling.text(0.1, -24.5, "bars: reach of the robot", fontsize=8.5, color="#5a626d")
    ceiling.set(xlabel="height of the goal (m)", ylabel="reachable goals, %",
                ylim=(-26, 104))  # fmt: skip
    ceiling.set_yticks([0, 25, 50, 75, 100])
    ceiling.set_title("Reachable goals by height")
    ceiling.legend(loc="center", bbox_to_anchor=(0.45, 0.5))
    return figure


def main() -> None:
    """Write the pictures."""
    mpl.use("Agg")
    for name, draw in {"loop": loop, "seen": seen, "feasible": feasible, "earned": earned}.items():
        with rc_context(STYLE):
            figure = draw()
        (IMAGES / f"method_{name}.png").write_bytes(png(figure, dpi=110))


if __name__ == "__main__":
    main()
