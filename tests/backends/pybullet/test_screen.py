import subprocess

import pytest

from kinfeas.backends.pybullet import screen
from kinfeas.core.errors import KinfeasError

pytest.importorskip("pybullet")

from kinfeas.backends.pybullet.physics import Physics, PhysicsConfig


@pytest.fixture(autouse=True)
def linux(monkeypatch):
    monkeypatch.setattr(screen.sys, "platform", "linux")


@pytest.mark.parametrize("display", [":77", "127.0.0.1:77.0", "nonsense"])
def test_a_screen_that_does_not_answer_is_one_sentence(monkeypatch, display, capfd):
    monkeypatch.setenv("DISPLAY", display)
    with pytest.raises(KinfeasError, match=f"PyBullet cannot open one on DISPLAY '{display}'$"):
        Physics(PhysicsConfig(), gui=True)
    assert capfd.readouterr() == ("", "")


def test_no_screen_is_one_sentence(monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    with pytest.raises(KinfeasError, match="a window needs a screen, and DISPLAY names none"):
        Physics(PhysicsConfig(), gui=True)


def test_a_screen_that_never_answers_is_none(monkeypatch):
    def hangs(command, **_):
        raise subprocess.TimeoutExpired(command, 0.0)

    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(screen.subprocess, "run", hangs)
    with pytest.raises(KinfeasError, match="cannot open one"):
        screen.check_screen()


def test_a_screen_that_answers_is_one(monkeypatch):
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(screen, "_TRIAL", "")
    screen.check_screen()
