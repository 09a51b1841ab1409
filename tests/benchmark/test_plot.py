from kinfeas.benchmark.plot import table_figure
from kinfeas.viz.style import GOAL, png
from tests.benchmark.benchmark_cases import cells


def test_a_panel_for_each_robot_and_task():
    figure = table_figure(cells(), "A note.")
    shown = [axes for axes in figure.axes if axes.xaxis.get_visible()]
    assert (len(figure.axes), len(shown)) == (6, 4)
    assert png(figure).startswith(b"\x89PNG")


def test_a_panel_shows_ours_the_papers_and_the_ceiling():
    axes = table_figure(cells()).axes[0]
    assert [text.get_text() for text in axes.texts] == ["92.0", "60.0"]
    assert [label.get_text() for label in axes.get_yticklabels()] == ["learned, SAC", "follow_ee"]
    papers = [line for line in axes.lines if line.get_markeredgecolor() == GOAL]
    assert [float(line.get_xdata()[0]) for line in papers] == [90.2, 60.8]
    dashed = [line for line in axes.lines if line.get_linestyle() == "--"]
    assert [float(line.get_xdata()[0]) for line in dashed] == [98.0]


def test_a_row_has_its_name_where_the_first_task_has_no_panel():
    drawn = [cell for cell in cells() if (cell.robot, cell.task) != ("pr2", "ggr")]
    axes = table_figure(sorted(drawn, key=lambda cell: cell.robot)).axes[2]
    assert not axes.xaxis.get_visible()
    assert [label.get_text() for label in axes.get_yticklabels()] == ["learned, SAC", "follow_ee"]


def test_labels_stand_below_the_lowest_panel_of_a_column():
    labels = [axes.get_xlabel() for axes in table_figure(cells()).axes]
    assert [bool(label) for label in labels] == [False, True, False, False, True, False]
