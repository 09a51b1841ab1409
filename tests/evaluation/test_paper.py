import pytest

from kinfeas.evaluation.paper import LEARNED, PaperFigures, _table, paper_figures

TASKS = ("ggr", "ggr_restricted", "pick_place", "door", "drawer")


@pytest.mark.parametrize("world", ["analytic", "physics"])
@pytest.mark.parametrize("robot", ["pr2", "tiago", "hsr"])
def test_it_knows_all_tasks(robot, world):
    for task in TASKS:
        assert LEARNED in paper_figures(robot, task, world)


def test_follow_or_demonstrated():
    for task in TASKS:
        simple = {"follow_ee", "demonstrated_base"} & paper_figures("pr2", task).keys()
        assert simple == {"demonstrated_base" if task in ("door", "drawer") else "follow_ee"}


def test_figures_are_shares():
    assert paper_figures("pr2", "ggr")["geometric_modulation"] == PaperFigures(0.646, 0.696)
    assert paper_figures("hsr", "pick_place")["follow_ee"] == PaperFigures(0.0, 0.032)
    for robots in (_table().analytic, _table().physics):
        shares = [s for t in robots.values() for p in t.values() for f in p.values() for s in f]
        assert all(0.0 <= share <= 100.0 for share in shares)


def test_of_anything_else_it_knows_nothing():
    assert paper_figures("pr2", "fly") == paper_figures("my_robot", "ggr") == {}
