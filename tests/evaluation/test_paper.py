from kinfeas.evaluation.paper import PaperFigures, paper_figures


def test_figures_of_the_table():
    assert paper_figures("pr2", "ggr")["geometric_modulation"] == PaperFigures(0.646, 0.696)
    assert paper_figures("hsr", "pick_place")["follow_ee"] == PaperFigures(0.0, 0.032)
    assert "follow_ee" not in paper_figures("pr2", "door")
    assert paper_figures("pr2", "fly") == paper_figures("my_robot", "ggr") == {}
