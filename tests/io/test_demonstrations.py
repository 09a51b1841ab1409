from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinfeas.core.errors import KinfeasError
from kinfeas.io.demonstrations import (
    Demonstration,
    columns,
    read_demonstration,
    write_demonstration,
)

FIELDS = ("time", "ee_pose", "base_pose", "object_pose")


def demonstration(samples=5, seed=0):
    rng = np.random.default_rng(seed)
    poses = rng.normal(size=(3, samples, 7))
    poses[..., 3:] /= np.sqrt(np.sum(poses[..., 3:] ** 2, axis=-1, keepdims=True))
    return Demonstration(np.cumsum(rng.uniform(0.01, 0.1, samples)), *poses)


def changed(row, name, value):
    """Return two good rows, one entry of which is replaced."""
    good = [0.0, *([0.0] * 6 + [1.0]) * 3]
    rows = [good, [0.1, *good[1:]]]
    rows[row][columns().index(name)] = value
    return rows


@given(samples=st.integers(2, 20), seed=st.integers(0, 1000))
def test_what_is_written_is_read_back(tmp_path_factory, samples, seed):
    path = tmp_path_factory.mktemp("demonstrations") / "one.csv"
    written = demonstration(samples, seed)
    write_demonstration(written, path)
    read = read_demonstration(path)
    for name in FIELDS:
        np.testing.assert_allclose(getattr(read, name), getattr(written, name), atol=1e-15)


def test_the_base_may_be_missing(tmp_path):
    full, path = demonstration(), tmp_path / "one.csv"
    write_demonstration(replace(full, base_pose=np.full((5, 7), np.nan)), path)
    result = read_demonstration(path)
    assert result.base_pose.shape == (5, 7)
    assert not result.has_base


@pytest.mark.parametrize(("moves", "warnings"), [(0.0, 0), (0.3, 1)])
def test_motion_in_a_gap_is_reported(tmp_path, caplog, moves, warnings):
    time, pose = np.arange(40) * 0.05, np.tile([0.0] * 6 + [1.0], (40, 1))
    time[20:], pose[20:, 0] = time[20:] + 2.0, moves
    path = tmp_path / "one.csv"
    write_demonstration(Demonstration(time, pose, pose, pose), path)
    read_demonstration(path)
    assert len(caplog.records) == warnings


@pytest.mark.parametrize(("rows", "place"), [
    (changed(0, "time", 0.0)[:1], "at least 2"),
    (changed(0, "base_y", "nan"), "row 1: base_pose: y"),
    (changed(1, "time", "inf"), "row 2: time"),
    (changed(1, "time", 0.0), "row 2: time"),
    (changed(1, "object_qw", 0.99), "row 2: object_pose"),
])  # fmt: skip
def test_invalid_samples_of_tables(tmp_path, rows, place):
    path = tmp_path / "one.csv"
    path.write_text("".join(",".join(map(str, line)) + "\n" for line in [columns(), *rows]))
    with pytest.raises(KinfeasError, match=f"^{path}.*{place}"):
        read_demonstration(path)


def test_invalid_arrays_are_not_written(tmp_path):
    shown = demonstration()
    for changes in ({"time": shown.time * 0.0}, {"ee_pose": shown.ee_pose * np.nan}):
        with pytest.raises(KinfeasError, match=next(iter(changes))):
            write_demonstration(replace(shown, **changes), tmp_path / "one.csv")
    assert not list(tmp_path.iterdir())
