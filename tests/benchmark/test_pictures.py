import numpy as np
import pytest

from kinfeas.benchmark import pictures
from kinfeas.benchmark.pictures import (
    curves_figure,
    draw_pictures,
    evaluation_curve,
    table_figure,
    training_curve,
    workspace_figure,
)
from kinfeas.benchmark.runs import Run
from kinfeas.viz.style import png
from tests.benchmark.benchmark_cases import cells, findings, result, study


def metrics(end, success, evaluations):
    steps = np.linspace(0.0, end, 5)
    evaluated = np.full(5, np.nan)
    evaluated[[2, 4]] = evaluations
    return {
        "steps": steps,
        "train/success": np.array([np.nan, *np.linspace(0.0, success, 4)]),
        "evaluation/success": evaluated,
    }


def test_curves_have_common_steps():
    runs = [metrics(1000, 0.8, (0.7, 0.9)), metrics(2000, 0.8, (0.5, 0.7))]
    steps, success = training_curve(runs)
    assert steps[-1] == 1000.0
    assert np.isnan(success[:, 0]).all()
    np.testing.assert_allclose(success[:, -1], [0.8, 0.8 / 3.0])
    steps, success = evaluation_curve(runs)
    np.testing.assert_allclose(steps, [750.0, 1500.0])
    np.testing.assert_allclose(success, [[0.7, 0.9], [0.5, 0.7]])


def test_a_run_without_a_finished_episode_has_no_curve():
    short = {**metrics(1000, 0.8, 0.9), "train/success": np.full(5, np.nan)}
    assert np.isnan(training_curve([short, metrics(1000, 0.8, 0.9)])[1][0]).all()


@pytest.fixture
def runs(tmp_path):
    made = []
    for robot, algorithm, seed in (("pr2", "sac", 0), ("pr2", "sac", 1), ("pr2", "td3", 0)):
        folder = tmp_path / f"{robot}-{algorithm}-{seed}"
        folder.mkdir()
        (folder / "metrics.csv").write_text(
            "steps,seconds,train/success,evaluation/success\n0,0,,\n1000,1,0.4,\n2000,2,0.8,0.9\n"
        )
        made.append(Run(folder, robot, algorithm, seed, "ggr"))
    return made


def test_learning_curves(runs):
    figure = curves_figure(runs, {"pr2": {"ceiling": 0.98, "paper": 0.902}})
    assert [axes.get_title(loc="left") for axes in figure.axes] == ["PR2, ggr"]
    names = [text.get_text() for text in figure.axes[0].get_legend().get_texts()]
    assert "SAC training, mean and std of 2 seeds" in names
    assert [text.get_text() for text in figure.axes[0].texts] == ["paper 90.2%", "ceiling 98.0%"]


def test_table_has_a_panel_for_each_robot_variant_and_task():
    figure = table_figure(cells(), "A note.")
    assert len(figure.axes) == 3 * 2
    first = figure.axes[0]
    assert [label.get_text() for label in first.get_yticklabels()] == [
        "learned, SAC", "learned, SAC, feasibility filter", "follow_ee",
    ]  # fmt: skip
    assert [text.get_text() for text in first.texts] == ["92.0", "97.0", "60.0"]
    assert png(figure).startswith(b"\x89PNG")


def test_workspace():
    figure = workspace_figure(
        {"hsr": [result(0.9, learned=True)] * 3, "mine": [result(0.9, learned=True)]}
    )
    assert len(figure.axes) == 4
    assert figure.axes[0].get_title(loc="left") == "HSR: 0.50% infeasible steps"
    assert [len(line.get_xdata()) for line in figure.axes[0].lines] == [27, 3, 1]


def test_pictures_of_a_benchmark(runs, monkeypatch):
    monkeypatch.setattr(pictures, "_examples", lambda robot, jobs: {})
    monkeypatch.setattr(pictures, "workspace_figure", lambda spaces: curves_figure(runs, {}))
    monkeypatch.setattr(pictures, "episodes_figure", lambda *_: curves_figure(runs, {}))
    chosen = study({"robots": ["pr2", "hsr"]})
    drawn = draw_pictures(chosen, runs, findings(), cells())
    assert set(drawn) == {"table", "learning_curves", "workspace", "examples-pr2", "examples-hsr"}
    physical = study({"robots": ["pr2", "hsr"], "backend": "pybullet"})
    assert set(draw_pictures(physical, [], [], cells())) == {"table"}
