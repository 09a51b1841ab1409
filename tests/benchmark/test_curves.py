import numpy as np
import pytest

from kinfeas.benchmark.curves import curves_figure, evaluation_curve, training_curve
from kinfeas.benchmark.runs import Run
from kinfeas.viz.style import png


def metrics(end, success, judged):
    steps = np.linspace(0.0, end, 5)
    seen = np.full(5, np.nan)
    seen[[2, 4]] = judged
    return {
        "steps": steps,
        "seconds": steps / 1000.0,
        "train/success": np.array([np.nan, *np.linspace(0.0, success, 4)]),
        "evaluation/success": seen,
    }


def test_seeds_are_put_on_common_steps():
    curve = training_curve([metrics(1000, 0.8, 0.9), metrics(2000, 0.8, 0.9)])
    assert curve.steps[-1] == 1000.0
    assert np.isnan(curve.mean[0])
    assert curve.mean[-1] == pytest.approx((0.8 + 0.8 / 3.0) / 2.0)
    assert curve.deviation[-1] > 0.0


def test_evaluations_are_taken_in_order():
    curve = evaluation_curve([metrics(1000, 0.8, (0.7, 0.9)), metrics(2000, 0.8, (0.5, 0.7))])
    np.testing.assert_allclose(curve.steps, [750.0, 1500.0])
    np.testing.assert_allclose(curve.mean, [0.6, 0.8])
    np.testing.assert_allclose(curve.deviation, [np.sqrt(0.02)] * 2)


def test_one_seed_has_no_deviation():
    assert not training_curve([metrics(1000, 0.8, 0.9)]).deviation.any()


def test_a_run_too_short_for_a_training_episode_has_no_curve():
    short = {**metrics(1000, 0.8, 0.9), "train/success": np.full(5, np.nan)}
    assert np.isnan(training_curve([short, metrics(1000, 0.8, 0.9)]).mean).all()


def test_algorithms_share_a_panel(tmp_path):
    runs = []
    for robot, algorithm, seed in [
        ("pr2", "sac", 0),
        ("pr2", "sac", 1),
        ("pr2", "td3", 0),
        ("hsr", "sac", 0),
    ]:
        folder = tmp_path / f"{robot}-{algorithm}-{seed}"
        folder.mkdir()
        (folder / "metrics.csv").write_text(
            "steps,seconds,train/success,evaluation/success\n0,0,,\n1000,1,0.4,\n2000,2,0.8,0.9\n"
        )
        runs.append(Run(folder, robot, algorithm, seed, "ggr"))
    figure = curves_figure(runs, {"pr2": {"ceiling": 0.98, "paper": 0.902}})
    assert [axes.get_title(loc="left") for axes in figure.axes] == ["PR2, ggr", "HSR, ggr"]
    names = [text.get_text() for text in figure.axes[0].get_legend().get_texts()]
    assert "SAC training, mean and std of 2 seeds" in names
    assert "TD3 training, 1 seed" in names
    texts = [text.get_text() for text in figure.axes[0].texts]
    assert texts == ["paper 90.2%", "ceiling 98.0%"]
    assert png(figure).startswith(b"\x89PNG")
    # They hide neither the ends of the curves nor each other, and stay clear of the next panel.
    panel, beside = figure.axes[0].get_window_extent(), figure.axes[1].get_window_extent()
    labels = [text.get_window_extent() for text in figure.axes[0].texts]
    assert all(panel.x1 < label.x0 < label.x1 < beside.x0 for label in labels)
    assert labels[0].y1 <= labels[1].y0
