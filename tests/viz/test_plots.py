import numpy as np
import pytest

from kinfeas.scenes.scene import read_scene
from kinfeas.viz.plots import learning_curve, read_metrics
from kinfeas.viz.style import png


def test_the_learning_curve_is_drawn_with_its_levels(tmp_path):
    header = "steps,seconds,train/success,evaluation/success"
    rows = "0,0.5,,\n1000,30,0.25,\n2000,60,0.5,0.75\n3000,9"  # cut short by a kill
    (tmp_path / "metrics.csv").write_text(f"{header}\n{rows}")
    metrics = read_metrics(tmp_path)
    np.testing.assert_array_equal(metrics["steps"], [0.0, 1000.0, 2000.0, 3000.0])
    np.testing.assert_array_equal(metrics["evaluation/success"], [np.nan, np.nan, 0.75, np.nan])
    whole = {name: values[:3] for name, values in metrics.items()}
    figure = learning_curve(whole, {"follow_ee": 0.6, "ceiling": 0.98})
    assert len(figure.axes[0].texts) == 2
    assert png(figure).startswith(b"\x89PNG")


def test_pages_are_self_contained(hsr, recordings):
    pytest.importorskip("viser")
    from kinfeas.viz.pages import replay_html, scene_html
    from kinfeas.viz.replay import replay_of

    replay = replay_of(recordings[0], hsr, "HSR")
    for html in (scene_html(read_scene("room")), replay_html(replay)):
        assert html.lstrip().lower().startswith("<!doctype html")
        assert "<title>kinfeas: " in html
        assert not any(place in html for place in ('src="http', "src='http", 'href="http'))
