import numpy as np
import pytest

from kinfeas.robots.loading import load_robot
from kinfeas.viz.pictures.robot import robot_figure
from kinfeas.viz.pictures.style import png


@pytest.mark.parametrize("name", ["pr2", "tiago", "hsr"])
def test_draws_the_robot_from_two_sides(name):
    robot = load_robot(name)
    figure = robot_figure(robot)
    assert len(figure.axes) == 2
    assert name in figure.get_suptitle()
    for axes in figure.axes:
        (solids,) = axes.get_images()
        left, right, bottom, top = solids.get_extent()
        assert right - left > 0.5  # metres
        assert top - bottom > 0.8
        assert np.asarray(solids.get_array())[..., 3].max() == pytest.approx(1.0)
    assert png(figure, dpi=60).startswith(b"\x89PNG")
