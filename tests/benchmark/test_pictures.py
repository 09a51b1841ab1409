import numpy as np
import pytest

from kinfeas.benchmark import pictures
from kinfeas.benchmark.pictures import (
    curves_figure,
    draw_pictures,
    evaluation_curve,
    training_curve,
    workspace_figure,
)
from kinfeas.benchmark.runs import Run
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
