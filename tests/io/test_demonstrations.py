import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinfeas.core.errors import KinfeasError
from kinfeas.io.demonstrations import (
    Demonstration,
    columns,
    demonstration_files,
    read_demonstration,
    write_demonstration,
)

DOCUMENT = Path(__file__).parents[2] / "docs" / "demonstrations.md"


def read_demonstrations(folder):
    return [read_demonstration(path) for path in demonstration_files(folder)]


FIELDS = ("time", "ee_pose", "base_pose", "object_pose")


def demonstration(samples=5, seed=0):
    """Return a random demonstration whose quaternions are unit."""
    rng = np.random.default_rng(seed)
    poses = rng.normal(size=(3, samples, 7))
    poses[..., 3:] /= np.sqrt(np.sum(poses[..., 3:] ** 2, axis=-1, keepdims=True))
    return Demonstration(np.cumsum(rng.uniform(0.01, 0.1, samples)), *poses)


def write_table(path, header, rows):
    path.write_text("".join(",".join(map(str, line)) + "\n" for line in [header, *rows]))
    return path


def changed(row, name, value):
    """Return two good rows, one entry of which is replaced."""
    good = [0.0, *([0.0] * 6 + [1.0]) * 3]
    rows = [good, [0.1, *good[1:]]]
    rows[row][columns().index(name)] = value
    return rows


@pytest.mark.parametrize("suffix", [".csv", ".NPZ"])
@given(samples=st.integers(2, 20), seed=st.integers(0, 1000))
def test_what_is_written_is_read_back(tmp_path_factory, suffix, samples, seed):
    path = tmp_path_factory.mktemp("demonstrations") / f"one{suffix}"
    written = demonstration(samples, seed)
    write_demonstration(written, path)
    read = read_demonstration(path)
    for name in FIELDS:
        np.testing.assert_allclose(getattr(read, name), getattr(written, name), atol=1e-15)


def test_the_documented_file_can_be_read(tmp_path):
    table = re.search(r"```csv\n(.*?)```", DOCUMENT.read_text(), re.DOTALL)[1]
    (tmp_path / "one.csv").write_text(table)
    assert read_demonstration(tmp_path / "one.csv").time.tolist() == [0.0, 0.02, 0.04]


@pytest.mark.parametrize("suffix", [".csv", ".npz"])
def test_the_base_may_be_missing(tmp_path, suffix):
    full, path = demonstration(), tmp_path / f"one{suffix}"
    write_demonstration(replace(full, base_pose=np.full((5, 7), np.nan)), path)
    found = read_demonstration(path)
    assert found.base_pose.shape == (5, 7)
    assert not found.has_base


@pytest.mark.parametrize(
    ("rows", "place"),
    [
        ([], "at least 2"),
        (changed(0, "time", 0.0)[:1], "at least 2"),
        (changed(0, "base_y", "nan"), "line 2, base_pose"),
        (changed(1, "time", "inf"), "line 3, time"),
        (changed(1, "time", 0.0), "line 3, time"),
        (changed(1, "object_qw", 0.99), "line 3, object_pose"),
    ],
)
def test_invalid_samples_of_tables(tmp_path, rows, place):
    path = write_table(tmp_path / "one.csv", columns(), rows)
    with pytest.raises(KinfeasError, match=f"^{path}.*{place}"):
        read_demonstration(path)


@pytest.mark.parametrize("name", ["time", "ee_qz", "base_x", "object_y"])
def test_missing_columns_and_arrays(tmp_path, name):
    header = [column for column in columns() if column != name]
    path = write_table(tmp_path / "one.csv", header, [])
    with pytest.raises(KinfeasError, match=f"line 1: column '{name}'"):
        read_demonstration(path)
    np.savez(tmp_path / "one.npz", time=np.arange(5.0))
    with pytest.raises(KinfeasError, match="'ee_pose'"):
        read_demonstration(tmp_path / "one.npz")


INVALID = {
    "ee_pose": np.zeros((5, 6)),
    "time": np.arange(2.0),
    "time[2]": np.array([0.0, 1.0, 1.0, 2.0, 3.0]),
    "object_pose[0]": np.full((5, 7), np.nan),
    "base_pose[0]": np.zeros((5, 7)),
}


@pytest.mark.parametrize("key", INVALID)
def test_invalid_arrays_are_neither_read_nor_written(tmp_path, key):
    name, place = key.partition("[")[0], re.escape(key if key != "time" else "ee_pose")
    shown = demonstration()
    np.savez(tmp_path / "one.npz", **{**vars(shown), name: INVALID[key]})
    with pytest.raises(KinfeasError, match=place):
        read_demonstration(tmp_path / "one.npz")
    for suffix in ("csv", "npz"):
        with pytest.raises(KinfeasError, match=place):
            write_demonstration(replace(shown, **{name: INVALID[key]}), tmp_path / f"two.{suffix}")
        assert not (tmp_path / f"two.{suffix}").exists()


def test_other_files_and_folders(tmp_path):
    for call in (read_demonstration, lambda path: write_demonstration(demonstration(), path)):
        with pytest.raises(KinfeasError, match=r"one\.txt"):
            call(tmp_path / "one.txt")
    for folder in (tmp_path, tmp_path / "none"):
        with pytest.raises(KinfeasError, match=f"^{folder}"):
            read_demonstrations(folder)
