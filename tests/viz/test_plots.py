import pytest

from kinfeas.scenes.scene import read_scene


def test_pages_are_self_contained(hsr, recordings):
    pytest.importorskip("viser")
    from kinfeas.viz.pages import replay_html, scene_html
    from kinfeas.viz.replay import replay_of

    replay = replay_of(recordings[0], hsr, "HSR")
    for html in (scene_html(read_scene("room")), replay_html(replay)):
        assert html.lstrip().lower().startswith("<!doctype html")
        assert "<title>kinfeas: " in html
        assert not any(place in html for place in ('src="http', "src='http", 'href="http'))
