"""Motions along the paths of files: waypoints and recordings."""

from dataclasses import replace

import numpy as np
import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import IDENTITY, distance
from kinfeas.io.demonstrations import write_demonstration
from kinfeas.io.run_log import About, Moment, Recorder
from kinfeas.plugins.replay import Replay, read_recording
from kinfeas.plugins.waypoints import Waypoints, read_waypoints
from tests.builders import assert_near, random_poses
from tests.plugins.conftest import DT, SHOWN, WAYPOINTS, run, write_waypoints

TIME = [0.0, 6.0, 16.0, 40.0]
YAML = "poses:\n- [1, 2, 3, 0, 0, 0, 1]\n- [1, 2, 4, 0, 0, 0.7071, 0.7071]\n"
CSV = "x,y,z,qx,qy,qz,qw\n1,2,3,0,0,0,1\n1,2,4,0,0,0.7071,0.7071\n"
TIMED = "note,qw,x,y,z,qx,qy,qz,time\na,1,1,2,3,0,0,0,0.5\nb,0.7071,1,2,4,0,0,0.7071,2\n"


def from_the_first(generator, duration):
    """Return poses and twists of a motion that begins at the first waypoint; target: origin."""
    path, twists, _ = run(generator, WAYPOINTS[:1], IDENTITY[np.newaxis], duration)
    return path[:, 0], twists[:, 0]


def test_passes_every_waypoint_smoothly(files):
    poses, twists = from_the_first(Waypoints(file=files["waypoints"]), 60.0)
    for waypoint in WAYPOINTS:
        assert np.add(*distance(poses, waypoint)).min() < 0.03
    # Where the turn reverses, the motion would jerk by 0.1 rad/s if it only kept to its limits.
    assert np.abs(np.diff(twists, axis=0)).max() < 0.05


@pytest.mark.parametrize("gain", [0.5, 2.0])
def test_errors_decay_at_the_gain(files, gain):
    generator = Waypoints(file=files["waypoints"], gain=gain)
    ee, end = generator.goal_pose({}, IDENTITY[np.newaxis]), {"phase": np.ones(1)}
    ee[:, 0] += 0.01
    twist, _ = generator.twist(end, ee, IDENTITY[np.newaxis], np.array([DT]))
    np.testing.assert_allclose(twist, [[-0.01 * gain, 0.0, 0.0, 0.0, 0.0, 0.0]], atol=1e-9)


def test_meets_the_times_of_the_file_and_rests_at_repeated_waypoints(tmp_path):
    file = write_waypoints(tmp_path / "timed.csv", time=TIME)
    poses, _ = from_the_first(Waypoints(file=file, max_angular_velocity=10.0), 50.0)
    for moment, waypoint in zip(TIME, WAYPOINTS, strict=True):
        assert_near(poses[round(moment / DT)], waypoint, 2e-3, 1e-2)
    rest = WAYPOINTS[[0, 1, 1, 2]]
    file = write_waypoints(tmp_path / "rest.csv", rest, [0.0, 20.0, 80.0, 100.0])
    poses, _ = from_the_first(Waypoints(file=file, max_angular_velocity=10.0), 100.0)
    assert distance(poses[round(22.0 / DT) : round(78.0 / DT)], rest[1])[0].max() < 2e-3
    with pytest.raises(KinfeasError, match="waypoint 3"):
        Waypoints(file=write_waypoints(tmp_path / "untimed.csv", rest))


@pytest.mark.parametrize("dt", [0.02, DT])
@pytest.mark.parametrize("seconds", [1.0, 20.0])
def test_path_is_the_same_at_any_speed_and_rate(tmp_path, seconds, dt):
    angle = np.linspace(0.0, 2.0 * np.pi, 100)
    poses = IDENTITY + 0.1 * np.stack([np.cos(angle), np.sin(angle), *np.zeros((5, 100))], axis=1)
    write_waypoints(tmp_path / "circle.csv", poses, np.linspace(0.0, seconds, 100))
    generator = Waypoints(file=str(tmp_path / "circle.csv"), frame="world")
    path, _, _ = run(generator, poses[:1] + 0.3 * np.eye(1, 7), IDENTITY[np.newaxis], 30.0, dt)
    away = np.linalg.norm(path[:, 0, :3] - poses[0, :3], axis=1)
    begun = int(np.argmax(away < 0.011))  # from afar, the EE comes to the first waypoint first
    assert away[begun] < 0.011
    np.testing.assert_allclose(
        np.linalg.norm(path[begun + round(8.0 / dt) :, 0, :2], axis=1), 0.1, atol=1e-3
    )


@pytest.mark.parametrize(
    ("name", "text", "time"),
    [("w.yml", YAML + "time: [0.5, 2]\n", [0.5, 2.0]), ("w.csv", CSV, None),
     ("W.CSV", TIMED, [0.5, 2.0])],
)  # fmt: skip
def test_files_are_yaml_or_csv(tmp_path, name, text, time):
    (tmp_path / name).write_text(text)
    poses, read = read_waypoints(tmp_path / name)
    half = np.sqrt(0.5)
    assert np.allclose(poses, [[1, 2, 3, 0, 0, 0, 1], [1, 2, 4, 0, 0, half, half]], atol=1e-15)
    assert (None if read is None else read.tolist()) == time


@pytest.mark.parametrize(("name", "text", "named"), [
    ("w.yaml", "poses:\n- [1, 2, 3, 0, 0, 0, 1]\n", "at least 2"),
    ("w.yaml", YAML + "speed: 2\n", "'speed'"),
    ("w.yaml", YAML + "time: [1, 1]\n", "row 2"),
    ("w.yaml", YAML.replace("0.7071]", "0.9]"), "row 2"),
    ("w.csv", "x,y,z,qx,qy,qz\n", "'qw'"),
    ("w.csv", CSV.replace("4,0", "inf,0"), "row 2"),
    ("w.csv", TIMED.replace(",2\n", ",nan\n"), "row 2"),
])  # fmt: skip
def test_wrong_files_raise(tmp_path, name, text, named):
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(KinfeasError, match=f"{path}.*{named}"):
        read_waypoints(path)


HEADER = "time,ee_x,ee_y,ee_z,ee_qx,ee_qy,ee_qz,ee_qw\n"
ABOUT = About("pr2", "ggr", "follow_ee", "analytic", 0.1, ("a", "b"), "2026-01-01T00:00:00+00:00")


def test_repeats_a_slow_recording_to_the_moment(tmp_path):
    slow = replace(SHOWN, time=SHOWN.time * 20.0)
    write_demonstration(slow, tmp_path / "slow.csv")
    generator = Replay(file=str(tmp_path / "slow.csv"), frame="world")
    poses, _, _ = run(generator, slow.ee_pose[:1], IDENTITY[np.newaxis], slow.time[-1])
    steps = np.round(slow.time / DT).astype(int)
    assert_near(poses[steps, 0], slow.ee_pose, 6e-3, 2e-2)  # half a step, at most


@pytest.mark.parametrize("waits", [True, False])
def test_recordings_in_their_own_time_end_with_their_last_moment(tmp_path, waits):
    write_demonstration(replace(SHOWN, time=SHOWN.time * 20.0), tmp_path / "slow.csv")
    generator = Replay(file=str(tmp_path / "slow.csv"), frame="world", waits=waits)
    finished = generator.finished({"phase": np.array([0.99, 1.0])}, np.zeros((2, 7)))
    assert finished.tolist() == [waits, True]


def test_reads_an_ee_without_base_and_object(tmp_path):
    path = tmp_path / "hand.csv"
    path.write_text(HEADER + "0,1,2,3,0,0,0,1\n0.5,1,2,4,0,0,0,1\n")
    time, ee_pose, object_pose = read_recording(path, "goal")
    assert time.tolist() == [0.0, 0.5]
    assert ee_pose[:, 2].tolist() == [3.0, 4.0]
    assert np.isnan(object_pose).all()
    with pytest.raises(KinfeasError, match=r"hand\.csv.*object_x"):
        read_recording(path, "object")


def read_run(path, desired, times, frame):
    """Return what is read of a run, after writing it."""
    with Recorder(path, ABOUT) as recorder:
        for time, pose in zip(times, desired, strict=True):
            two, twist = np.zeros(2), np.zeros(6)
            recorder.write(Moment(time, np.nan, IDENTITY, two, pose, IDENTITY, twist, two, True, 0))
    return read_recording(path, frame)


def test_reads_the_desired_motion_of_a_run(tmp_path):
    desired, path = random_poses(5), tmp_path / "RUN.CSV"
    time, ee_pose, _ = read_run(path, desired, [0.0, 0.1, 0.2, 0.3, 0.3], "world")
    assert np.allclose(time, [0.0, 0.1, 0.2, 0.3])
    assert np.allclose(ee_pose, desired[:4], atol=1e-7)
    for frame, times in (("object", np.arange(5)), ("goal", [0.1] * 5), ("goal", [0, 2, 1, 1, 1])):
        with pytest.raises(KinfeasError, match=path.name):
            read_run(path, desired, times, frame)
