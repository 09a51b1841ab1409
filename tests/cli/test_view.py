import json

import pytest

SCENE = "{name: 'm[/x]', size: [4, 4], objects: {'t[b]': {urdf: table.urdf}}}"


@pytest.fixture
def record(kinfeas, tmp_path):
    """The record of a short run."""
    words = ("--robot", "hsr", "--backend", "analytic", "--goal", "1", "0", "0.8")
    kinfeas("deploy", "pretrained", *words, "--no-real-time", "--seconds", "0.2",
            "--record", "run.csv")  # fmt: skip
    return tmp_path / "run.csv"


def test_room(kinfeas, tmp_path):
    done = kinfeas("view", "--json", "room.json", code=0)
    assert "drawer_shelf" in done.out
    facts = json.loads((tmp_path / "room.json").read_text())
    assert facts["objects"]["door_shelf"]["joint_positions"] == {"hinge": 0.0}
    assert facts["handles"]["drawer"]["pose"][:3] == pytest.approx([-2.81, 0.015, 0.525])


def test_own_scene_as_table_picture_and_page(kinfeas, tmp_path):
    pytest.importorskip("viser")
    (tmp_path / "mine.yaml").write_text(SCENE)
    done = kinfeas(
        "view", "--scene", "mine.yaml", "--picture", "mine.png", "--html", "mine.html", code=0
    )
    assert "scene m[/x]" in done.out
    assert "t[b]" in done.out
    assert (tmp_path / "mine.png").read_bytes().startswith(b"\x89PNG")
    assert (tmp_path / "mine.html").stat().st_size > 1000


def test_replay_of_a_run(kinfeas, record, tmp_path):
    kinfeas("view", "--record", "run.csv", "--picture", "run.png", "--json", "run.json", code=0)
    assert (tmp_path / "run.png").read_bytes().startswith(b"\x89PNG")
    facts = json.loads((tmp_path / "run.json").read_text())
    assert facts["events"][0]["event"] == "start"
    assert facts["seconds"] == pytest.approx(0.2)
    record.write_bytes(record.read_bytes()[:-300])
    kinfeas("view", "--record", "run.csv", code=0)
