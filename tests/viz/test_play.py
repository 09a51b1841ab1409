import numpy as np
import pytest

from kinfeas.core.spatial import distance
from kinfeas.io.demonstrations import read_demonstration
from kinfeas.sim2real.servo.choice import Choice
from kinfeas.viz.play import PlayPage
from kinfeas.viz.server import serving
from studies.browser import BINARY, Browser, on_screen

pytest.importorskip("viser")


@pytest.fixture
def server():
    with serving("kinfeas play") as server:
        yield server


@pytest.fixture
def make_page(server, tmp_path):
    pages = []

    def make(**changes):
        pages.append(PlayPage(server, Choice("pr2", **changes), tmp_path / "demonstrations"))
        pages[-1].start()
        return pages[-1]

    yield make
    for one in pages:
        one.close()


def test_robots_of_two_policies_follow_the_handle_and_the_motion_is_saved(make_page, tmp_path):
    page = make_page(second_policy="follow_ee")
    page.record()
    page.handle.position = page.handle.position + np.array([0.5, 0.3, 0.1])
    for _ in range(150):
        page.frame()
    page.record()
    for episode in page._episodes:
        assert distance(episode.ee_pose, page.target)[0] < 0.005
    saved = read_demonstration(tmp_path / "demonstrations" / "001.csv")
    assert saved.has_base
    assert np.ptp(saved.ee_pose[:, 0]) == pytest.approx(0.5, abs=0.02)


@pytest.mark.slow
@pytest.mark.skipif(BINARY is None, reason="needs Chromium")
@pytest.mark.parametrize("size", [(1280, 800), (390, 844)], ids=["desktop", "phone"])
def test_the_mouse_drags_the_target_in_a_browser(make_page, server, tmp_path, size):
    page = make_page()
    browser = Browser(tmp_path / "profile", size, lambda: page.run(0.04))
    try:
        browser.call("Page.navigate", url=f"http://127.0.0.1:{server.get_port()}")
        browser.wait(server.get_clients)
        page.run(6.0)
        camera = next(iter(server.get_clients().values())).camera
        height = page.handle.position[2]
        x, y = on_screen(camera, page.handle.position + np.array([0.0, 0.0, 0.25]))
        _, up = on_screen(camera, page.handle.position + np.array([0.0, 0.0, 0.5]))
        browser.mouse("mouseMoved", x, y)
        page.run(1.0)
        browser.mouse("mousePressed", x, y)
        for share in np.linspace(0.1, 1.0, 10):
            browser.mouse("mouseMoved", x, y + share * (up - y))
            page.run(0.2)
        browser.mouse("mouseReleased", x, up)
        page.run(3.0)
        assert page.handle.position[2] > height + 0.1
        assert page._episodes[0].ee_pose[2] > height + 0.1
    finally:
        browser.close()
