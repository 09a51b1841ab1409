"""The motion through waypoints comes to the first one and through all, smoothly and to time."""

import numpy as np
import pytest

from kinfeas.core import registry
from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import IDENTITY, compose, relative
from kinfeas.plugins.waypoints import Waypoints
from tests.plugins.conftest import DT, apart, run, speeds
from tests.plugins.properties import (
    check_everything,
    check_moves_with_target,
    check_numbers,
    starts_and_targets,
)

POSES = np.array(
    [
        [-0.3, 0.0, 0.2, 0.0, 0.0, 0.0, 1.0],
        [-0.15, 0.1, 0.25, 0.0, np.sin(0.3), 0.0, np.cos(0.3)],
        [-0.1, 0.0, 0.1, 0.0, 0.0, 0.0, 1.0],
        [0.0, 0.05, 0.0, 0.0, 0.0, np.sin(0.5), np.cos(0.5)],
    ]
)
TIME = [0.0, 6.0, 16.0, 40.0]


def write(path, poses=POSES, time=None):
    rows = [",".join(map(repr, row)) for row in np.asarray(poses).tolist()]
    path.write_text("x,y,z,qx,qy,qz,qw\n" + "\n".join(rows) + "\n")
    if time is not None:
        rows = [f"{row},{t}" for row, t in zip(rows, time, strict=True)]
        path.write_text("x,y,z,qx,qy,qz,qw,time\n" + "\n".join(rows) + "\n")
    return str(path)


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    return write(tmp_path_factory.mktemp("waypoints") / "w.csv")


@pytest.fixture(scope="module")
def timed(tmp_path_factory):
    return write(tmp_path_factory.mktemp("waypoints") / "timed.csv", time=TIME)


@pytest.mark.parametrize("frame", ["object", "world"])
def test_does_what_every_motion_has_to(file, frame):
    check_everything(Waypoints(file=file, frame=frame))


def test_moves_with_the_target(file):
    check_moves_with_target(Waypoints(file=file))


def on_the_path(generator, duration):
    """Return poses and twists of a motion that begins at the first waypoint; target: origin."""
    poses, twists, _ = run(generator, POSES[:1], IDENTITY[np.newaxis], duration)
    return poses[:, 0], twists[:, 0]


def test_passes_every_waypoint(file):
    poses, _ = on_the_path(Waypoints(file=file), 60.0)
    for waypoint in POSES:
        metres, radians = apart(poses, waypoint)
        assert (metres + radians).min() < 0.03


def test_goes_at_full_speed_between_gentle_ends(tmp_path):
    file = write(tmp_path / "w.csv", POSES[[0, 2]] * np.array([2.0, 2.0, 2.0, 1.0, 1.0, 1.0, 1.0]))
    poses, twists, _ = run(
        Waypoints(file=file, ramp=2.0), 2.0 * POSES[:1], IDENTITY[np.newaxis], 20.0
    )
    linear, _ = speeds(twists[:, 0])
    way = 2.0 * np.linalg.norm(POSES[2, :3] - POSES[0, :3])
    duration = way / 0.1 + 2.0
    assert linear[0] < 0.005
    assert np.allclose(linear[21 : round((duration - 2.0) / DT) - 1], 0.1, atol=1e-3)
    assert np.all(apart(poses[round(duration / DT) + 1 :, 0], poses[-1, 0])[0] < 1e-6)


def test_is_smooth(file):
    _, twists = on_the_path(Waypoints(file=file), 60.0)
    # Where the turn goes back, the motion would jerk by 0.1 rad/s if it only kept to its limits.
    assert np.abs(np.diff(twists, axis=0)).max() < 0.05


def test_keeps_to_the_times_of_the_file(timed):
    poses, _ = on_the_path(Waypoints(file=timed, max_angular_velocity=10.0), 50.0)
    for moment, waypoint in zip(TIME, POSES, strict=True):
        metres, radians = apart(poses[round(moment / DT)], waypoint)
        assert metres < 2e-3
        assert radians < 1e-2


def test_a_repeated_waypoint_with_times_is_a_rest(tmp_path):
    file = write(tmp_path / "w.csv", POSES[[0, 0, 1]], [0.0, 5.0, 20.0])
    poses, _ = on_the_path(Waypoints(file=file), 4.0)
    assert apart(poses, POSES[0])[0].max() < 0.02


def test_frames_say_what_the_path_moves_with(file):
    start, target = starts_and_targets(5, 1)
    for frame, end in (
        ("object", compose(target, np.repeat(POSES[-1:], 5, axis=0))),
        ("goal", target),
        ("world", np.repeat(POSES[-1:], 5, axis=0)),
    ):
        generator = Waypoints(file=file, frame=frame)
        goal = generator.goal_pose(generator.start(start, target, []), target)
        assert np.allclose(relative(goal, end), IDENTITY, atol=1e-9)


def test_two_waypoints_make_a_straight_line(tmp_path):
    file = write(tmp_path / "w.csv", POSES[[0, 2]])
    poses, _ = on_the_path(Waypoints(file=file), 10.0)
    way = POSES[2, :3] - POSES[0, :3]
    assert np.linalg.norm(np.cross(poses[:, :3] - POSES[0, :3], way), axis=-1).max() < 1e-9


def test_a_ramp_longer_than_the_path_is_all_of_it(file):
    knots = [Waypoints(file=file, ramp=ramp).path.knots for ramp in (1e3, 1e9)]
    assert np.array_equal(*knots)


def test_refuses_what_it_cannot_follow(tmp_path, file):
    with pytest.raises(KinfeasError, match="waypoint 2: must differ from the one before"):
        Waypoints(file=write(tmp_path / "w.csv", POSES[[0, 0, 1]]))
    with pytest.raises(KinfeasError, match="unknown frame 'room'; known are goal, object, world"):
        Waypoints(file=file, frame="room")
    with pytest.raises(KinfeasError, match=r"motion generator 'waypoints'.*'file' is missing"):
        registry.build("kinfeas.motion_generators", "waypoints", {})
    names = ["ramp", "gain", "max_velocity", "max_angular_velocity"]
    check_numbers(lambda **given: Waypoints(file=file, **given), names)
