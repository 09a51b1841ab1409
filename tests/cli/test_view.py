import json

import pytest

BROKEN = "{name: mine, size: [4, 4], objects: {table: {urdf: tabel.urdf}}}"


def test_shows_the_room(kinfeas, tmp_path):
    done = kinfeas("view", "--json", "room.json")
    assert done.code == 0
    assert "drawer_shelf" in done.out
    facts = json.loads((tmp_path / "room.json").read_text())
    assert facts["objects"]["door_shelf"]["joint_positions"] == {"hinge": 0.0}
    assert facts["handles"]["door"]["joint"] == "hinge"
    assert facts["handles"]["drawer"]["pose"][:3] == pytest.approx([-2.81, 0.015, 0.525])


def test_draws_a_user_s_scene(kinfeas, tmp_path):
    (tmp_path / "mine.yaml").write_text(BROKEN.replace("tabel", "table"))
    done = kinfeas("view", "--scene", "mine.yaml", "--picture", "mine.png")
    assert done.code == 0
    assert "scene mine, 4 x 4 m" in done.out
    assert done.out.endswith("\nmine.png\n")
    assert (tmp_path / "mine.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--scene", "rom"], "unknown scene 'rom' (did you mean 'room'?)"),
        (["--scene", "none.yaml"], "none.yaml: cannot be read"),
        (["--scene", ""], "unknown scene ''"),
        (["--picture", "."], ".: is a folder, not the path of a file"),
        (["--set", "objects.boxx.fixed=true"], "no 'objects.boxx' (did you mean 'box'?); known"),
        (["--set", "objects.box.position=[3, 0, 0.5]"], "'pick_table' and 'box' overlap"),
        (["--picture", "/nowhere/a.png"], "/nowhere/a.png: cannot be written"),
    ],
)
def test_bad_input_is_one_line(kinfeas, arguments, message):
    done = kinfeas("view", *arguments)
    assert done.code == 2
    assert done.out == ""
    assert message in done.err
    assert done.err.startswith("error: ")
    assert done.err.count("\n") == 1


def test_a_missing_urdf_is_one_line(kinfeas, tmp_path):
    (tmp_path / "mine.yaml").write_text(BROKEN)
    done = kinfeas("view", "--scene", "mine.yaml")
    assert done.code == 2
    assert "there is no file" in done.err
    assert done.err.count("\n") == 1


@pytest.fixture
def record(kinfeas, tmp_path):
    """The record of a short run."""
    kinfeas("deploy", "pretrained", "--backend", "analytic", "--goal", "1", "0", "0.8",
            "--no-real-time", "--seconds", "0.2", "--record", "run.csv")  # fmt: skip
    return tmp_path / "run.csv"


def test_replays_a_run(kinfeas, record, tmp_path):
    done = kinfeas("view", "--record", "run.csv", "--picture", "run.png", "--json", "run.json")
    assert done.code == 0, done.err
    assert "the goal was not reached within 0.2 s" in done.out
    assert (tmp_path / "run.png").read_bytes().startswith(b"\x89PNG")
    assert done.out.endswith("\nrun.png\n")
    facts = json.loads((tmp_path / "run.json").read_text())
    assert facts["events"][0]["event"] == "start"
    assert facts["seconds"] == pytest.approx(0.2)


def test_replays_a_run_that_was_cut_short(kinfeas, record):
    record.write_bytes(record.read_bytes()[:-300])
    done = kinfeas("view", "--record", "run.csv")
    assert done.code == 0, done.err
    assert "the record breaks off here" in done.out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--scene", "room"], "--scene and --record exclude each other"),
        (["--live"], "--live and --record exclude each other"),
        ([], "none.csv: cannot be read"),
    ],
)
def test_a_record_that_is_none_is_one_line(kinfeas, arguments, message):
    done = kinfeas("view", "--record", "none.csv", *arguments)
    assert done.code == 2
    assert message in done.err
    assert done.err.count("\n") == 1


def test_names_are_shown_as_they_stand(kinfeas, tmp_path):
    scene = BROKEN.replace("tabel", "table").replace("mine", "'m[/x]'").replace("table:", "'t[b]':")
    (tmp_path / "mine.yaml").write_text(scene)
    done = kinfeas("view", "--scene", "mine.yaml")
    assert done.code == 0, done.err
    assert "scene m[/x]" in done.out
    assert "t[b]" in done.out
