import pytest

from kinfeas.scenes.scene import read_scene
from kinfeas.viz.pages import episode_html, scene_html


def check_self_contained(html):
    assert html.lstrip().lower().startswith("<!doctype html")
    for elsewhere in ('src="http', "src='http", 'href="http'):
        assert elsewhere not in html


def test_a_scene_page_is_self_contained():
    pytest.importorskip("viser")
    html = scene_html(read_scene("room"))
    check_self_contained(html)
    assert len(html) < 2_000_000


def test_an_episode_page_is_self_contained(hsr, recordings):
    pytest.importorskip("viser")
    check_self_contained(episode_html(recordings[0], hsr))
