import pytest

from kinfeas.evaluation.paper import LEARNED, PaperFigures, paper_figures

TASKS = ("ggr", "ggr_restricted", "pick_place", "door", "drawer")


@pytest.mark.parametrize("world", ["analytic", "physics"])
@pytest.mark.parametrize("robot", ["pr2", "tiago", "hsr"])
def test_figures_are_shares_of_every_task(robot, world):
    for task in TASKS:
        figures = paper_figures(robot, task, world)
        assert LEARNED in figures
        for one in figures.values():
            assert 0.0 <= one.success <= 1.0
            assert 0.0 <= one.within_5cm <= 1.0


def test_figures_of_the_table():
    assert paper_figures("pr2", "ggr")["geometric_modulation"] == PaperFigures(0.646, 0.696)
    assert paper_figures("hsr", "pick_place")["follow_ee"] == PaperFigures(0.0, 0.032)
    assert "follow_ee" not in paper_figures("pr2", "door")
    assert paper_figures("pr2", "fly") == paper_figures("my_robot", "ggr") == {}
