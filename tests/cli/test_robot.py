import json
from functools import partial

import pytest

from kinfeas.robots.loading import read_robot
from tests.cli.conftest import check_one_line
from tests.importer.conftest import ARM


@pytest.fixture
def robot(kinfeas, tmp_path, monkeypatch):
    """Return a function that runs `kinfeas robot import dolly.urdf ARGUMENTS`, with few goals."""
    monkeypatch.setattr("kinfeas.importer.reach._GOALS", 8)
    monkeypatch.setattr("kinfeas.importer.reach._STAGES", (4, 16))
    (tmp_path / "dolly.urdf").write_text(ARM)
    return partial(kinfeas, "robot", "import", "dolly.urdf")


def test_other_commands_take_the_robot(robot, kinfeas, tmp_path):
    robot("--out", "new", "--json", "found.json", "--picture", "dolly.png", code=0)
    found = json.loads((tmp_path / "found.json").read_text())
    known = read_robot(tmp_path / "new" / "dolly.yaml")
    assert list(found["arm"]) == [joint.name for joint in known.arm] == ["pan", "lift", "elbow"]
    assert found["guessed_velocities"] == ["pan"]
    assert len(found["heights_m"]) == len(found["reachable"])
    assert (tmp_path / "dolly.png").read_bytes().startswith(b"\x89PNG")
    words = ("--policy", "follow_ee", "--episodes", "1", "--set", "world.max_seconds=1")
    kinfeas("evaluate", "--robot", "new/dolly.yaml", *words, code=0)


def test_existing_files_are_kept(robot, tmp_path):
    (tmp_path / "new").mkdir()
    (tmp_path / "new" / "dolly.yaml").write_text("mine")
    check_one_line(robot("--out", "new"), "new/dolly.yaml")
    assert (tmp_path / "new" / "dolly.yaml").read_text() == "mine"
    robot("--out", "new", "--name", "other", code=0)
