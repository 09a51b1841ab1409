import json

import numpy as np
import pytest

from kinfeas.io.demonstrations import read_demonstrations
from tests.cli.conftest import is_one_line


@pytest.mark.parametrize("mechanism", ["door", "drawer"])
@pytest.mark.parametrize("suffix", ["csv", "npz"])
def test_demonstrations_are_written_and_told_of(kinfeas, tmp_path, mechanism, suffix):
    arguments = (mechanism, "--count", "2", "--out", "shown", "--format", suffix)
    outcome = kinfeas("demonstrate", *arguments, "--json", "out.json")
    assert outcome.code == 0, outcome.err
    for motion in ("grasp", "open"):
        assert motion in outcome.out
        files = sorted(path.name for path in (tmp_path / "shown" / motion).iterdir())
        assert files == [f"00.{suffix}", f"01.{suffix}"]
        read = read_demonstrations(tmp_path / "shown" / motion)
        figures = json.loads((tmp_path / "out.json").read_text())[motion]
        assert max(one.time[-1] for one in read) == figures["max_duration_s"]


def test_both_formats_hold_the_same(kinfeas, tmp_path):
    for suffix in ("csv", "npz"):
        assert kinfeas("demonstrate", "drawer", "--count", "1", "--out", suffix,
                       "--format", suffix).code == 0  # fmt: skip
    (one,), (two,) = (read_demonstrations(tmp_path / suffix / "open") for suffix in ("csv", "npz"))
    np.testing.assert_array_equal(one.ee_pose, two.ee_pose)
    np.testing.assert_array_equal(one.base_pose, two.base_pose)


def test_the_same_command_writes_the_same(kinfeas, tmp_path):
    for out in ("one", "two"):
        assert (
            kinfeas("demonstrate", "drawer", "--count", "2", "--seed", "4", "--out", out).code == 0
        )
    for path in (tmp_path / "one").rglob("*.csv"):
        other = tmp_path / "two" / path.relative_to(tmp_path / "one")
        assert path.read_bytes() == other.read_bytes()


def test_a_picture_is_drawn(kinfeas, tmp_path):
    arguments = ("drawer", "--count", "2", "--out", "shown", "--picture", "picture.png")
    outcome = kinfeas("demonstrate", *arguments)
    assert outcome.code == 0, outcome.err
    assert (tmp_path / "picture.png").read_bytes().startswith(b"\x89PNG")
    assert outcome.out.endswith("\npicture.png\n")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("window", "--out", "new"), "'door', 'drawer'"),
        (("door",), "--out"),
        (("door", "--out", "taken"), "new or an empty folder"),
        (("door", "--out", "taken/file"), "new or an empty folder"),
        (("door", "--out", "taken/file/new"), "cannot be written"),
        (("door", "--out", "new", "--count", "0"), "--count"),
        (("door", "--out", "new", "--seed", "-1"), "--seed"),
        (("door", "--out", "new", "--format", "pickle"), "'csv', 'npz'"),
        (("door", "--out", "new", "--picture", "none/picture.png"), "cannot be written"),
    ],
)
def test_bad_input_is_one_line(kinfeas, tmp_path, arguments, words):
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken" / "file").write_text("mine")
    outcome = kinfeas("demonstrate", *arguments)
    assert is_one_line(outcome), outcome.err
    assert words in outcome.err
    assert (tmp_path / "taken" / "file").read_text() == "mine"
    assert not (tmp_path / "new").exists()


def test_an_empty_folder_is_filled(kinfeas, tmp_path):
    (tmp_path / "empty").mkdir()
    assert kinfeas("demonstrate", "drawer", "--count", "1", "--out", "empty").code == 0
