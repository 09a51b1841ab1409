import os
import re
import resource
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
    read_demonstrations,
    write_demonstration,
)

DOCUMENT = Path(__file__).parents[2] / "docs" / "demonstrations.md"
FIELDS = ("time", "ee_pose", "base_pose", "object_pose")


def demonstration(samples=5, seed=0):
    """Return a random demonstration whose quaternions are unit."""
    rng = np.random.default_rng(seed)
    poses = rng.normal(size=(3, samples, 7))
    poses[..., 3:] /= np.sqrt(np.sum(poses[..., 3:] ** 2, axis=-1, keepdims=True))
    return Demonstration(np.cumsum(rng.uniform(0.01, 0.1, samples)), *poses)


def write_table(path, header=None, rows=None):
    """Write a CSV file of two good samples, its header or rows replaced."""
    good = [0.0, *([0.0] * 6 + [1.0]) * 3]
    rows = [good, [0.1, *good[1:]]] if rows is None else rows
    lines = [header or columns(), *rows]
    path.write_text("".join(",".join(map(str, line)) + "\n" for line in lines))
    return path


def changed(row, name, value):
    """Return two good rows, one entry of which is replaced."""
    good = [0.0, *([0.0] * 6 + [1.0]) * 3]
    rows = [good, [0.1, *good[1:]]]
    rows[row][columns().index(name)] = value
    return rows


@pytest.mark.parametrize("suffix", [".csv", ".npz"])
@given(samples=st.integers(2, 20), seed=st.integers(0, 1000))
def test_what_is_written_is_read_back(tmp_path_factory, suffix, samples, seed):
    path = tmp_path_factory.mktemp("demonstrations") / f"one{suffix}"
    written = demonstration(samples, seed)
    write_demonstration(written, path)
    read = read_demonstration(path)
    for name in FIELDS:
        np.testing.assert_allclose(getattr(read, name), getattr(written, name), atol=1e-15)


@pytest.mark.parametrize("suffix", [".csv", ".npz"])
def test_a_demonstration_may_know_no_base(tmp_path, suffix):
    known, path = demonstration(), tmp_path / f"one{suffix}"
    unknown = Demonstration(known.time, known.ee_pose, np.full((5, 7), np.nan), known.object_pose)
    write_demonstration(unknown, path)
    assert np.isnan(read_demonstration(path).base_pose).all()
    if suffix == ".csv":
        assert "base" not in path.read_text()


def test_none_stands_for_a_base_that_was_not_recorded(tmp_path):
    shown = demonstration()
    unknown = Demonstration(shown.time, shown.ee_pose, None, shown.object_pose)
    assert np.isnan(unknown.base_pose).all()
    assert unknown.base_pose.shape == shown.base_pose.shape
    write_demonstration(unknown, tmp_path / "0.csv")
    assert np.isnan(read_demonstration(tmp_path / "0.csv").base_pose).all()


def test_a_folder_is_read_in_the_order_of_names(tmp_path):
    for seed, name in enumerate(("b.npz", "a.csv", "c.csv")):
        write_demonstration(demonstration(seed=seed), tmp_path / name)
    (tmp_path / "notes.txt").write_text("not a demonstration")
    names = [path.name for path in demonstration_files(tmp_path)]
    assert names == ["a.csv", "b.npz", "c.csv"]
    read = read_demonstrations(tmp_path)
    assert [shown.time[0] for shown in read] == [demonstration(seed=s).time[0] for s in (1, 0, 2)]


@pytest.mark.parametrize("suffix", ["CSV", "NPZ", "Csv"])
def test_a_suffix_may_be_in_capitals(tmp_path, suffix):
    path = tmp_path / f"one.{suffix}"
    write_demonstration(demonstration(), path)
    assert [one.name for one in tmp_path.iterdir()] == [path.name]
    (read,) = read_demonstrations(tmp_path)
    np.testing.assert_allclose(read.ee_pose, demonstration().ee_pose, atol=1e-15)


def test_folders_of_demonstrations_below_are_named(tmp_path):
    for name in ("open", "grasp", "notes"):
        (tmp_path / name).mkdir()
    (tmp_path / "notes" / "a.txt").touch()
    for name in ("open", "grasp"):
        write_demonstration(demonstration(), tmp_path / name / "0.csv")
    named = f"choose one: {tmp_path / 'grasp'}, {tmp_path / 'open'}"
    with pytest.raises(KinfeasError, match=rf"holds no demonstrations itself, .*; {named}$"):
        demonstration_files(tmp_path)


def test_other_columns_and_any_order_are_allowed(tmp_path):
    write_demonstration(demonstration(), tmp_path / "one.csv")
    lines = (tmp_path / "one.csv").read_text().splitlines()
    other = ["grip," + ",".join(reversed(lines[0].split(",")))]
    other += ["open," + ",".join(reversed(line.split(","))) for line in lines[1:]]
    (tmp_path / "other.csv").write_text("\n".join(other) + "\n\n")
    one, two = read_demonstrations(tmp_path)
    np.testing.assert_array_equal(one.object_pose, two.object_pose)


def test_quaternions_are_made_unit(tmp_path):
    path = write_table(tmp_path / "one.csv", rows=changed(1, "ee_qw", 1.0009))
    np.testing.assert_array_equal(read_demonstration(path).ee_pose[1], [0, 0, 0, 0, 0, 0, 1])


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ([], "has 0 samples, at least 2"),
        (changed(0, "time", 0.0)[:1], "has 1 samples"),
        (changed(1, "ee_x", "abc"), "line 3, ee_x: 'abc' is not a number"),
        (changed(1, "ee_x", ""), "line 3, ee_x: '' is not a number"),
        (changed(0, "base_y", "nan"), "line 2, base_pose: is not finite"),
        (changed(1, "time", "inf"), "line 3, time: is not finite"),
        (changed(1, "time", 0.0), "line 3, time: does not ascend"),
        (changed(1, "object_qw", 0.99), "line 3, object_pose: has no unit quaternion"),
        ([[0.0] * 21, [0.0] * 22], "line 2: has 21 entries for 22 columns"),
    ],
)
def test_bad_samples_are_named(tmp_path, rows, message):
    path = write_table(tmp_path / "one.csv", rows=rows)
    with pytest.raises(KinfeasError, match=message) as error:
        read_demonstration(path)
    assert str(error.value).startswith(str(path))


@pytest.mark.parametrize("name", ["time", "ee_qz", "base_x", "object_y"])
def test_a_missing_column_is_named(tmp_path, name):
    header = [column for column in columns() if column != name]
    path = write_table(tmp_path / "one.csv", header=header)
    with pytest.raises(KinfeasError, match=f"line 1: column '{name}' is missing"):
        read_demonstration(path)


def test_a_repeated_column_is_named(tmp_path):
    path = write_table(tmp_path / "one.csv", header=[*columns(), "ee_x"])
    with pytest.raises(KinfeasError, match="line 1: column 'ee_x' is repeated"):
        read_demonstration(path)


def arrays(**replaced):
    shown = demonstration()
    known = {name: getattr(shown, name) for name in FIELDS} | replaced
    return {name: value for name, value in known.items() if value is not None}


@pytest.mark.parametrize(
    ("replaced", "message"),
    [
        ({"time": None}, "key 'time' is missing"),
        ({"object_pose": None}, "key 'object_pose' is missing"),
        ({"ee_pose": np.zeros((5, 6))}, r"ee_pose: must hold numbers of shape \(5, 7\)"),
        ({"time": np.zeros((5, 1))}, r"time: must hold numbers of shape \(5,\)"),
        ({"time": np.array(list("abcde"))}, "time: must hold numbers"),
        ({"time": np.array([0, 1, 1, 2, 3])}, r"time\[2\]: does not ascend"),
        ({"time": np.array([0, 1, 2, 3, 1e300])}, r"time\[4\]: is more than 100000 s after"),
        ({"ee_pose": np.full((5, 7), 1e300)}, r"ee_pose\[0\]: is beyond 100,000,000 m"),
        ({"ee_pose": np.zeros((5, 7))}, r"ee_pose\[0\]: has no unit quaternion"),
        ({"ee_pose": np.array([None] * 5)}, "no NPZ file of plain arrays"),
    ],
)
def test_bad_archives_are_refused(tmp_path, replaced, message):
    path = tmp_path / "one.npz"
    np.savez(path, **arrays(**replaced))
    with pytest.raises(KinfeasError, match=message):
        read_demonstration(path)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("one.csv", b"", "column 'time' is missing"),
        ("one.csv", b"\xff\xfe\x00", "not a text file in UTF-8"),
        ("one.csv", b'time,"ee_x\n', "is no CSV file"),
        ("one.npz", b"PK\x03\x04 cut", "is no NPZ file"),
        ("one.npz", b"", "is no NPZ file"),
        ("one.npz", b"text", "is no NPZ file"),
        ("one.txt", b"text", "must be a .csv or .npz file"),
    ],
)
def test_broken_files_are_refused(tmp_path, name, content, message):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(KinfeasError, match=message):
        read_demonstration(tmp_path / name)


def test_a_lone_array_is_no_archive(tmp_path):
    np.save(tmp_path / "one.npy", np.zeros(3))
    (tmp_path / "one.npy").rename(tmp_path / "one.npz")
    with pytest.raises(KinfeasError, match="no NPZ file"):
        read_demonstration(tmp_path / "one.npz")


def test_what_is_not_there(tmp_path):
    with pytest.raises(KinfeasError, match="no such folder"):
        read_demonstrations(tmp_path / "none")
    with pytest.raises(KinfeasError, match="holds no demonstrations"):
        read_demonstrations(tmp_path)
    with pytest.raises(KinfeasError, match="cannot be read"):
        read_demonstration(tmp_path / "none.csv")


@pytest.mark.parametrize("name", ["one.txt", "none/one.csv", "none/one.npz"])
def test_what_cannot_be_written(tmp_path, name):
    with pytest.raises(KinfeasError, match=r"must be a|cannot be written"):
        write_demonstration(demonstration(), tmp_path / name)


@pytest.mark.parametrize("suffix", ["csv", "npz"])
@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"ee_pose": np.zeros((5, 6))}, r"ee_pose: must hold numbers of shape \(5, 7\), not"),
        ({"time": np.arange(2.0)}, r"ee_pose: must hold numbers of shape \(2, 7\), not"),
        ({"time": np.zeros(5)}, r"time\[1\]: does not ascend"),
        ({"object_pose": np.full((5, 7), np.nan)}, r"object_pose\[0\]: is not finite"),
        ({"ee_pose": np.zeros((5, 7))}, r"ee_pose\[0\]: has no unit quaternion"),
    ],
)
def test_what_could_not_be_read_back_is_not_written(tmp_path, suffix, changes, message):
    path = tmp_path / f"one.{suffix}"
    with pytest.raises(KinfeasError, match=message):
        write_demonstration(replace(demonstration(), **changes), path)
    assert not path.exists()


@pytest.mark.parametrize("suffix", ["csv", "npz"])
def test_a_failed_write_leaves_the_old_file(tmp_path, suffix):
    path = tmp_path / f"one.{suffix}"
    write_demonstration(demonstration(), path)
    old = path.read_bytes()
    limit = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4000, limit[1]))
    try:
        with pytest.raises(KinfeasError, match=f"one.{suffix}: cannot be written: File too large"):
            write_demonstration(demonstration(500), path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limit)
    assert path.read_bytes() == old
    assert list(tmp_path.iterdir()) == [path]


def test_the_documented_file_can_be_read(tmp_path):
    table = re.search(r"```csv\n(.*?)```", DOCUMENT.read_text(), re.DOTALL)[1]
    (tmp_path / "one.csv").write_text(table)
    assert read_demonstration(tmp_path / "one.csv").time.tolist() == [0.0, 0.02, 0.04]


def test_the_documented_code_writes_a_file(tmp_path, monkeypatch):
    code = re.search(r"```python\n(.*?)```", DOCUMENT.read_text(), re.DOTALL)[1]
    monkeypatch.chdir(tmp_path)
    exec(compile(code, str(DOCUMENT), "exec"), {})
    assert len(read_demonstration(tmp_path / "take.csv").time) == 100


@pytest.mark.parametrize("suffix", [".csv", ".npz"])
def test_a_pipe_or_a_device_is_no_file(tmp_path, suffix):
    pipe, device = tmp_path / f"pipe{suffix}", tmp_path / f"device{suffix}"
    os.mkfifo(pipe)
    device.symlink_to("/dev/zero")
    for path in (pipe, device):
        with pytest.raises(KinfeasError, match="cannot be read: it is not a regular file"):
            read_demonstration(path)
