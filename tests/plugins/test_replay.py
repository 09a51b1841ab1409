from dataclasses import replace

import numpy as np
import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import IDENTITY
from kinfeas.io.demonstrations import write_demonstration
from kinfeas.io.run_log import About, Moment, Recorder
from kinfeas.plugins.replay import Replay, read_recording
from tests.builders import assert_near
from tests.plugins.conftest import DT, SHOWN, random_poses, run

HEADER = "time,ee_x,ee_y,ee_z,ee_qx,ee_qy,ee_qz,ee_qw\n"
ABOUT = About("pr2", "ggr", "follow_ee", "analytic", 0.1, ("a", "b"), "2026-01-01T00:00:00+00:00")


def test_repeats_a_slow_recording_to_the_moment(tmp_path):
    slow = replace(SHOWN, time=SHOWN.time * 20.0)
    write_demonstration(slow, tmp_path / "slow.csv")
    generator = Replay(file=str(tmp_path / "slow.csv"), frame="world")
    poses, _, _ = run(generator, slow.ee_pose[:1], IDENTITY[np.newaxis], slow.time[-1])
    for i in range(0, len(slow.time), 10):
        assert_near(
            poses[round(slow.time[i] / DT), 0], slow.ee_pose[i], 6e-3, 2e-2
        )  # half a step, at most


def test_reads_an_ee_without_base_and_object(tmp_path):
    path = tmp_path / "hand.csv"
    path.write_text(HEADER + "0,1,2,3,0,0,0,1\n0.5,1,2,4,0,0,0,1\n")
    time, ee_pose, object_pose = read_recording(path, "goal")
    assert time.tolist() == [0.0, 0.5]
    assert ee_pose[:, 2].tolist() == [3.0, 4.0]
    assert np.isnan(object_pose).all()
    with pytest.raises(KinfeasError, match=r"hand\.csv.*object_x"):
        read_recording(path, "object")


def write_run(path, desired, times):
    with Recorder(path, ABOUT) as recorder:
        for time, pose in zip(times, desired, strict=True):
            two, twist = np.zeros(2), np.zeros(6)
            recorder.write(Moment(time, np.nan, IDENTITY, two, pose, IDENTITY, twist, two, True, 0))
    return path


@pytest.mark.parametrize("name", ["run.csv", "RUN.CSV"])
def test_reads_the_desired_motion_of_a_run(tmp_path, name):
    desired = random_poses(5, 0)
    path = write_run(tmp_path / name, desired, [0.0, 0.1, 0.2, 0.3, 0.3])
    time, ee_pose, _ = read_recording(path, "world")
    assert np.allclose(time, [0.0, 0.1, 0.2, 0.3])
    assert np.allclose(ee_pose, desired[:4], atol=1e-7)
    for frame, times in (("object", np.arange(5)), ("goal", [0.1] * 5), ("goal", [0, 2, 1, 1, 1])):
        with pytest.raises(KinfeasError, match=name):
            read_recording(write_run(path, desired, times), frame)
