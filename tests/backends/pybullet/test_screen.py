import subprocess

import pytest

from kinfeas.core.errors import KinfeasError

pytest.importorskip("pybullet")

from kinfeas.backends.pybullet import physics
from kinfeas.backends.pybullet.physics import Physics, PhysicsConfig


@pytest.mark.parametrize("display", [None, ":77", "nonsense"])
def test_a_window_without_a_screen_is_an_error(monkeypatch, display, capfd):
    monkeypatch.setattr(physics.sys, "platform", "linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    if display:
        monkeypatch.setenv("DISPLAY", display)
    with pytest.raises(KinfeasError, match=f"DISPLAY={display or ''}$"):
        Physics(PhysicsConfig(), gui=True)
    assert capfd.readouterr() == ("", "")


def test_a_screen_that_does_not_answer_is_an_error(monkeypatch):
    def hangs(command, **_):
        raise subprocess.TimeoutExpired(command, 0.0)

    monkeypatch.setattr(physics.sys, "platform", "linux")
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(physics.subprocess, "run", hangs)
    with pytest.raises(KinfeasError, match="DISPLAY"):
        Physics(PhysicsConfig(), gui=True)
