import numpy as np
from matplotlib.figure import Figure

from kinfeas.core.spatial import IDENTITY
from kinfeas.robots.urdf import Shape
from kinfeas.viz.drawing import (
    add_axes,
    draw_floor,
    draw_solids,
    show_all,
)
from kinfeas.viz.shapes import Solid, corners, robot_solids
from kinfeas.viz.style import ARM, BODY, png


def test_a_robot_has_an_arm_and_a_body_above_the_floor(robot):
    solids = robot_solids(robot, IDENTITY, robot.home["home"])
    points = corners(solids)
    assert {solid.colour for solid in solids} == {ARM, BODY}
    assert -0.05 < points[:, 2].min() < 0.5 < points[:, 2].max() < 2.2


def test_solids_fill_a_picture_and_the_nearer_one_is_seen():
    figure = Figure(figsize=(2.0, 1.0))
    axes = add_axes(figure, (0.0, 0.0, 1.0, 1.0), 0.0, np.deg2rad(20.0))
    near = Solid(Shape("box", (1.0, 0.1, 0.5), np.array([0, -1.0, 0.25, 0, 0, 0, 1])), "#ff0000")
    far = Solid(Shape("box", (1.0, 0.1, 0.5), np.array([0, 1.0, 0.25, 0, 0, 0, 1])), "#0000ff")
    floor = draw_floor(axes, corners([near, far]))
    draw_solids(axes, [near, far])
    show_all(axes, np.concatenate([corners([near, far]), floor]), 2.0)
    assert png(figure).startswith(b"\x89PNG")
    _, solids = axes.collections
    first, *_, last = solids.get_facecolors()
    assert last[0] > last[2]  # red is drawn last
    assert first[2] > first[0]
