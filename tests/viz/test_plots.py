import numpy as np
import pytest

from kinfeas.core.checks import CheckedMotion
from kinfeas.plugins.linear import Linear
from kinfeas.testing.trial import Trial, sample_motions
from kinfeas.viz.plots import learning_curve, motion_figure, read_metrics
from kinfeas.viz.style import png

TABLE = """steps,seconds,train/success,evaluation/success
0,0.5,,
1000,30,0.25,
2000,60,0.5,0.75
"""


@pytest.fixture
def run(tmp_path):
    (tmp_path / "metrics.csv").write_text(TABLE)
    return tmp_path


def test_metrics_are_read_as_columns(run):
    with (run / "metrics.csv").open("a") as file:
        file.write("3000,9")  # cut short by a kill
    metrics = read_metrics(run)
    np.testing.assert_array_equal(metrics["steps"], [0.0, 1000.0, 2000.0, 3000.0])
    np.testing.assert_array_equal(metrics["evaluation/success"], [np.nan, np.nan, 0.75, np.nan])


def test_the_learning_curve_names_its_levels(run):
    figure = learning_curve(read_metrics(run), {"follow_ee": 0.6, "ceiling": 0.98})
    texts = [text.get_text() for text in figure.axes[0].texts]
    assert texts == ["follow_ee 60.0%", "ceiling 98.0%"]
    assert png(figure).startswith(b"\x89PNG")


@pytest.mark.parametrize("limit", [0.1, None])
def test_paths_speeds_and_limits_are_drawn(limit):
    trial = Trial(duration=5.0, max_velocity=limit)
    samples = sample_motions(CheckedMotion(Linear()), trial)
    above, _, speed, _ = motion_figure("linear", samples, trial).axes
    assert len(above.lines) == 3 * 12
    assert len(speed.lines) == 12 + (limit is not None)
