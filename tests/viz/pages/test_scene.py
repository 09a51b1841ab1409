import sys

import numpy as np
import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.scenes.scene import read_scene
from kinfeas.viz.pages.scene import ScenePage


def test_without_viser_there_is_one_clear_line(monkeypatch):
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(
        KinfeasError, match=r"viser is not installed.*pip install 'kinfeas\[view\]'"
    ):
        ScenePage(read_scene("room"))


@pytest.fixture
def page():
    pytest.importorskip("viser")
    page = ScenePage(read_scene("room"))
    yield page
    page.close()


def test_a_page_stands_alone(page):
    html = page.html()
    assert html.lstrip().startswith("<!doctype html>")
    assert "<script src=" not in html
    assert len(html) < 2_000_000


def test_sliders_move_what_they_are_named_after(page):
    page.add_sliders()
    before = [np.array(solid.position) for solid in page._solids]
    page.move({"drawer_shelf": {"slide": 0.3}})
    ways = [after.position - at for at, after in zip(before, page._solids, strict=True)]
    moved = [way for way in ways if np.any(way != 0.0)]
    assert len(moved) == 6  # five boards and the handle
    np.testing.assert_allclose(moved, np.tile([0.3, 0.0, 0.0], (6, 1)), atol=1e-9)
