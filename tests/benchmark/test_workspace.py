import pytest

from kinfeas.benchmark.workspace import covered, workspace_figure
from kinfeas.viz.style import FAILURE, png
from tests.benchmark.benchmark_cases import result


def test_results_are_put_together(robot):
    one = covered(robot, [result(0.9, learned=True), result(0.8, learned=True)])
    assert one.feasible.shape == (18, 3)
    assert one.infeasible.shape == (2, 3)
    assert one.failed == pytest.approx(2.0 / 400.0)


def test_a_robot_is_seen_from_above_and_from_the_side(robot):
    flawless = result(1.0, learned=True)
    flawless["workspace"]["infeasible"] = []
    figure = workspace_figure([covered(robot, [flawless]), covered(robot, [result(0.9, True)])])
    assert len(figure.axes) == 4
    for axes, count in zip(figure.axes, (0, 1, 0, 1), strict=True):
        (failed,) = (line for line in axes.lines if line.get_color() == FAILURE)
        assert len(failed.get_xdata()) == count
        assert axes.get_aspect() == 1.0
    assert {axes.get_ylabel() for axes in figure.axes} == {"y (m)", "z (m)"}
    assert png(figure, 40).startswith(b"\x89PNG")


def test_all_of_the_legend_is_seen(robot):
    for robots in (1, 2, 3):
        figure = workspace_figure([covered(robot, [result(0.9, learned=True)])] * robots)
        figure.canvas.draw()
        (legend,) = figure.legends
        box = legend.get_window_extent()
        assert figure.bbox.x0 <= box.x0 < box.x1 <= figure.bbox.x1
