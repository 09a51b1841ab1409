"""Recordings of hands and of runs: what is read of them, and what they have to hold."""

import numpy as np
import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import IDENTITY
from kinfeas.io.run_log import About, Moment, Recorder
from kinfeas.plugins.replay import read_recording, resampled
from tests.plugins.conftest import door_demonstrations, random_poses

HEADER = "time,ee_x,ee_y,ee_z,ee_qx,ee_qy,ee_qz,ee_qw\n"
ABOUT = About("pr2", "ggr", "follow_ee", "analytic", 0.1, ("a", "b"), "2026-01-01T00:00:00+00:00")


def write_run(path, desired, times):
    with Recorder(path, ABOUT) as recorder:
        for time, pose in zip(times, desired, strict=True):
            two, twist = np.zeros(2), np.zeros(6)
            recorder.write(Moment(time, np.nan, IDENTITY, two, pose, IDENTITY, twist, two, True, 0))
    return path


def test_reads_a_hand_without_base_and_object(tmp_path):
    path = tmp_path / "hand.csv"
    path.write_text(HEADER + "0,1,2,3,0,0,0,1\n0.5,1,2,4,0,0,0,1\n")
    time, ee_pose, object_pose = read_recording(path, "goal")
    assert time.tolist() == [0.0, 0.5]
    assert ee_pose[:, 2].tolist() == [3.0, 4.0]
    assert np.isnan(object_pose).all()
    with pytest.raises(KinfeasError, match=r"hand\.csv: no pose of an object"):
        read_recording(path, "object")


@pytest.mark.parametrize("name", ["run.csv", "RUN.CSV"])
def test_reads_the_motion_that_a_run_was_to_make(tmp_path, name):
    desired = random_poses(5, 0)
    path = write_run(tmp_path / name, desired, np.arange(5) * 0.1)
    time, ee_pose, _ = read_recording(path, "world")
    assert np.allclose(time, np.arange(5) * 0.1)
    assert np.allclose(ee_pose, desired, atol=1e-7)
    with pytest.raises(KinfeasError, match=r"frame may be 'goal' instead"):
        read_recording(path, "object")


def test_a_second_line_of_a_moment_is_left_out(tmp_path):
    path = write_run(tmp_path / "run.csv", random_poses(4, 0), [0.0, 0.1, 0.2, 0.2])
    assert np.allclose(read_recording(path, "goal")[0], [0.0, 0.1, 0.2])


@pytest.mark.parametrize("times", [[0.1, 0.1, 0.1], [0.0, 0.2, 0.1, 0.15]])
def test_a_run_has_to_go_on(tmp_path, times):
    path = write_run(tmp_path / "run.csv", random_poses(len(times), 0), times)
    with pytest.raises(KinfeasError, match="their time must ascend"):
        read_recording(path, "goal")


def test_resampling_meets_the_samples():
    shown = door_demonstrations(1)[0]
    shares = (shown.time - shown.time[0]) / (shown.time[-1] - shown.time[0])
    assert np.allclose(resampled(shown.time, shown.ee_pose, shares), shown.ee_pose, atol=1e-9)
    assert resampled(shown.time, shown.ee_pose, np.array([0.0, 1.0])).shape == (2, 7)
