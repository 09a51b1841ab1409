import sys

import numpy as np
import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.scenes.scene import read_scene
from kinfeas.viz.pages import ScenePage, episode_html


def test_a_missing_viser_is_an_error_with_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(KinfeasError, match=r"kinfeas\[view\]"):
        ScenePage(read_scene("room"))


@pytest.fixture
def page():
    pytest.importorskip("viser")
    page = ScenePage(read_scene("room"))
    yield page
    page.close()


def check_self_contained(html):
    assert html.lstrip().lower().startswith("<!doctype html")
    for elsewhere in ('src="http', "src='http", 'href="http'):
        assert elsewhere not in html


def test_a_scene_page_is_self_contained(page):
    html = page.html()
    check_self_contained(html)
    assert len(html) < 2_000_000


def test_joints_move_their_shapes(page):
    page.add_sliders()
    before = [np.array(solid.position) for solid in page.solids]
    page.move({("drawer_shelf", "slide"): 0.3})
    ways = [after.position - at for at, after in zip(before, page.solids, strict=True)]
    moved = [way for way in ways if np.any(way != 0.0)]
    assert len(moved) == 6  # five boards and the handle
    np.testing.assert_allclose(moved, np.tile([0.3, 0.0, 0.0], (6, 1)), atol=1e-9)


def test_an_episode_page_is_self_contained(hsr, recordings):
    pytest.importorskip("viser")
    check_self_contained(episode_html(recordings[0], hsr))
