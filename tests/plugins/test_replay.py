"""A replay repeats a recording in its own time, wherever it is put, from any start."""

from dataclasses import replace

import numpy as np
import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import IDENTITY, compose, relative
from kinfeas.io.demonstrations import write_demonstration
from kinfeas.plugins.replay import Replay
from tests.plugins.conftest import DT, apart, door_demonstrations, run, speeds
from tests.plugins.properties import (
    check_everything,
    check_moves_with_target,
    check_numbers,
    starts_and_targets,
)

SHOWN = door_demonstrations(1)[0]
SLOW = replace(SHOWN, time=SHOWN.time * 20.0)
FRAMES = ("goal", "object", "world")


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("replay") / "shown.csv"
    write_demonstration(SHOWN, path)
    return str(path)


@pytest.fixture(scope="module")
def slow(tmp_path_factory):
    path = tmp_path_factory.mktemp("replay") / "slow.npz"
    write_demonstration(SLOW, path)
    return str(path)


@pytest.mark.parametrize("frame", FRAMES)
def test_does_what_every_motion_has_to(file, frame):
    check_everything(Replay(file=file, frame=frame))


@pytest.mark.parametrize("frame", ["goal", "object"])
def test_moves_with_the_target(file, frame):
    check_moves_with_target(Replay(file=file, frame=frame))


def test_repeats_a_slow_recording_to_the_moment(slow):
    generator = Replay(file=slow, frame="world")
    poses, _, _ = run(generator, SLOW.ee_pose[:1], IDENTITY[np.newaxis], SLOW.time[-1])
    for i in range(0, len(SLOW.time), 10):
        metres, radians = apart(poses[round(SLOW.time[i] / DT), 0], SLOW.ee_pose[i])
        assert metres < 6e-3  # half a step, at most
        assert radians < 2e-2


def test_a_fast_recording_is_slowed_down_but_not_bent(file):
    generator = Replay(file=file, frame="world")
    poses, twists, _ = run(generator, SHOWN.ee_pose[:1], IDENTITY[np.newaxis], 40.0)
    assert speeds(twists)[0].max() <= 0.1 * (1.0 + 1e-9)
    metres = np.linalg.norm(poses[:, 0, np.newaxis, :3] - SHOWN.ee_pose[:, :3], axis=-1)
    assert metres.min(axis=1).max() < 6e-3


def test_frames_say_where_it_takes_place(file):
    start, target = starts_and_targets(5, 1)
    end, begin = SHOWN.ee_pose[-1:], SHOWN.object_pose[:1]
    for frame, expected in (
        ("goal", target),
        ("object", compose(target, np.repeat(relative(end, begin), 5, axis=0))),
        ("world", np.repeat(end, 5, axis=0)),
    ):
        generator = Replay(file=file, frame=frame)
        goal = generator.goal_pose(generator.start(start, target, []), target)
        assert np.allclose(relative(goal, expected), IDENTITY, atol=1e-9)


def test_refuses_what_it_cannot_follow(file):
    with pytest.raises(KinfeasError, match=r"unknown frame 'goals'.*did you mean 'goal'"):
        Replay(file=file, frame="goals")
    with pytest.raises(KinfeasError, match=r"none\.csv: cannot be read: No such file"):
        Replay(file="none.csv")
    with pytest.raises(KinfeasError, match=r"must be a \.csv or \.npz file"):
        Replay(file="shown.txt")
    names = ["gain", "max_velocity", "max_angular_velocity"]
    check_numbers(lambda **given: Replay(file=file, **given), names)
