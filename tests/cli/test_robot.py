import json
import re

import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.robots.loading import read_robot
from tests.cli.conftest import is_one_line
from tests.importer.conftest import ARM, STUCK


@pytest.fixture
def robot(kinfeas, tmp_path, monkeypatch):
    """Return a function that runs `kinfeas robot import dolly.urdf ARGUMENTS`, with few goals."""
    monkeypatch.setattr("kinfeas.importer.reach._GOALS", 8)
    monkeypatch.setattr("kinfeas.importer.reach._STAGES", (4, 16))
    (tmp_path / "dolly.urdf").write_text(ARM)
    return lambda *arguments: kinfeas("robot", "import", "dolly.urdf", *arguments)


def test_writes_a_robot_that_other_commands_take(robot, kinfeas, tmp_path):
    outcome = robot("--out", "new", "--json", "found.json", "--picture", "dolly.png")
    assert outcome.code == 0, outcome.err
    found = json.loads((tmp_path / "found.json").read_text())
    known = read_robot(tmp_path / "new" / "dolly.yaml")
    assert found["arm"] == [joint.name for joint in known.arm] == ["pan", "lift", "elbow"]
    assert found["guessed_velocities"] == ["pan"]
    assert len(found["heights_m"]) == len(found["reachable"])
    assert (tmp_path / "dolly.png").read_bytes().startswith(b"\x89PNG")
    assert "3 joints: pan, lift, elbow" in outcome.out
    assert "kinfeas ceiling --robot new/dolly.yaml" in outcome.out
    evaluated = kinfeas(
        "evaluate", "--robot", "new/dolly.yaml", "--policy", "follow_ee", "--episodes", "2"
    )
    assert evaluated.code == 0, evaluated.err


def test_a_robot_without_shapes_is_told_of(robot, tmp_path):
    bare = re.sub(r"<collision>.*?</collision>", "", ARM)
    (tmp_path / "dolly.urdf").write_text(bare)
    outcome = robot("--out", "new", "--ee", "palm")
    assert outcome.code == 0, outcome.err
    assert "none: what touches what is not looked at" in outcome.out


def test_a_robot_without_shapes_is_drawn_as_a_skeleton(robot, tmp_path):
    bare = re.sub(r"<collision>.*?</collision>", "", ARM)
    (tmp_path / "dolly.urdf").write_text(bare)
    outcome = robot("--out", "new", "--ee", "palm", "--picture", "dolly.png")
    assert outcome.code == 0, outcome.err
    assert (tmp_path / "dolly.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("out", ["new/folder", "old"])
def test_what_fails_leaves_nothing_behind(robot, tmp_path, monkeypatch, out):
    def fail(robot):
        raise KinfeasError("no picture")

    (tmp_path / "old").mkdir()
    before = sorted(tmp_path.rglob("*"))
    with monkeypatch.context() as failing:
        failing.setattr("kinfeas.viz.figures.robot_figure", fail)
        assert robot("--out", out, "--picture", "dolly.png").code == 2
    assert sorted(tmp_path.rglob("*")) == before
    assert robot("--out", out, "--picture", "dolly.png").code == 0


def test_shows_what_was_guessed(robot):
    found = robot("--out", "new").out
    assert re.search(r"base.drive +│ differential", found)
    assert re.search(r"base.max_velocity +│ 0.2 m/s", found)
    assert re.search(r"arm.pan.velocity +│ 1 rad/s", found)
    assert "base.drive" not in robot("--out", "other", "--drive", "omnidirectional").out


def test_what_stands_still_and_how_to_go_on_is_told(robot, tmp_path):
    text = ARM
    for old, new in STUCK:
        text = text.replace(old, new)
    (tmp_path / "dolly.urdf").write_text(text)
    outcome = robot("--out", "my robots")
    assert outcome.code == 0, outcome.err
    assert re.search(r"stand still, for lack of room.*│ mount ", outcome.out)
    assert outcome.out.endswith("kinfeas ceiling --robot 'my robots/dolly.yaml'\n")


def test_what_is_there_stays(robot, tmp_path):
    (tmp_path / "new").mkdir()
    (tmp_path / "new" / "dolly.yaml").write_text("mine")
    outcome = robot("--out", "new")
    assert outcome.code == 2
    assert is_one_line(outcome)
    assert "new/dolly.yaml: is there already" in outcome.err
    assert (tmp_path / "new" / "dolly.yaml").read_text() == "mine"
    assert robot("--out", "new", "--name", "other").code == 0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--ee", "plam"), "there is no link 'plam' (did you mean 'palm'?)"),
        (("--base", "bass"), "there is no link 'bass' (did you mean 'base'?)"),
        (("--base", ""), "there is no link ''"),
        (("--name", "a/b"), "--name: 'name' must be printable"),
        (("--name", ""), "--name: 'name' must be printable"),
        (("--picture", "dolly.jpg"), "--picture: dolly.jpg must end in .png"),
        (("--json", "dolly.urdf"), "FILE.urdf and --json must differ"),
    ],
)
def test_bad_input_is_one_line(robot, tmp_path, arguments, message):
    outcome = robot("--out", "new", *arguments)
    assert outcome.code == 2
    assert is_one_line(outcome)
    assert message in outcome.err
    assert not (tmp_path / "new" / "dolly.yaml").exists()


def test_a_urdf_that_is_not_there_is_one_line(kinfeas):
    outcome = kinfeas("robot", "import", "none.urdf", "--out", "new")
    assert outcome.code == 2
    assert is_one_line(outcome)
    assert "none.urdf: cannot be read" in outcome.err
