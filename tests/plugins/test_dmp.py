"""The movement primitive reproduces its demonstration, and comes to any goal from any start."""

import sys

import numpy as np
import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import IDENTITY, compose, relative
from kinfeas.io.demonstrations import write_demonstration
from kinfeas.plugins.dmp import Dmp, learn
from kinfeas.plugins.replay import resampled
from tests.plugins.conftest import apart, door_demonstrations, run
from tests.plugins.properties import (
    check_everything,
    check_moves_with_target,
    check_numbers,
    starts_and_targets,
)

SHOWN = door_demonstrations(1)[0]
FAST = {"max_velocity": 10.0, "max_angular_velocity": 10.0}


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("dmp") / "shown.csv"
    write_demonstration(SHOWN, path)
    return str(path)


@pytest.fixture(scope="module")
def library():
    """Return the module that learns the force, an extra that is built from source."""
    reason = "movement_primitives is missing: the extra dmp is not installed"
    return pytest.importorskip("movement_primitives.dmp", reason=reason)


@pytest.fixture
def shown():
    """Return the demonstration in the frame of its end."""
    return relative(SHOWN.ee_pose, np.broadcast_to(SHOWN.ee_pose[-1], SHOWN.ee_pose.shape))


@pytest.mark.parametrize("frame", ["goal", "object"])
def test_does_what_every_motion_has_to(library, file, frame):
    check_everything(Dmp(file=file, frame=frame))


def test_moves_with_the_target(library, file):
    check_moves_with_target(Dmp(file=file))


def test_does_what_was_shown_in_the_same_time(library, file, shown):
    poses, _, _ = run(Dmp(file=file, **FAST), shown[:1], IDENTITY[np.newaxis], 8.0, 0.01)
    moments = np.arange(0.0, SHOWN.time[-1], 0.2)
    expected = resampled(SHOWN.time, shown, moments / SHOWN.time[-1])
    metres, radians = apart(poses[np.round(moments / 0.01).astype(int), 0], expected)
    assert metres.max() < 5e-3
    assert radians.max() < 0.02


def test_moves_as_the_library_does(library, file, shown):
    duration = SHOWN.time[-1]
    moments = np.linspace(0.0, 1.0, 201)
    model = library.CartesianDMP(1.0, 1.0 / 200, 25, smooth_scaling=True)
    model.imitate(
        moments, np.roll(resampled(SHOWN.time, shown, moments), 1, axis=1)[:, [1, 2, 3, 0, 4, 5, 6]]
    )
    _, twice = starts_and_targets(1, 0)
    start = np.concatenate([[0.3, -0.2, 0.4], shown[0, 3:]])[np.newaxis]
    start[0, 3:] = twice[0, 3:]
    w_first = np.concatenate([start[0, :3], start[0, [6, 3, 4, 5]]])
    model.configure(start_y=w_first, goal_y=np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]))
    _, theirs = model.open_loop(run_t=1.0)
    poses, _, _ = run(
        Dmp(file=file, **FAST), start, IDENTITY[np.newaxis], duration, duration / 1000
    )
    ours = poses[::5, 0]
    metres = np.linalg.norm(ours[:, :3] - theirs[: len(ours), :3], axis=1)
    dots = np.abs(np.sum(ours[:, [6, 3, 4, 5]] * theirs[: len(ours), 3:], axis=1))
    assert metres.max() < 1e-2
    assert 2.0 * np.arccos(np.minimum(dots.min(), 1.0)) < 0.03


def test_limits_change_the_time_and_not_the_shape(library, file, shown):
    fast, _, _ = run(Dmp(file=file, **FAST), shown[:1], IDENTITY[np.newaxis], 10.0, 0.01)
    slow, _, _ = run(Dmp(file=file), shown[:1], IDENTITY[np.newaxis], 40.0)
    metres = np.linalg.norm(slow[:, 0, np.newaxis, :3] - fast[:, 0, :3], axis=-1)
    assert metres.min(axis=1).max() < 5e-3


def test_ends_at_the_goal_or_where_it_ended_about_the_object(library, file):
    start, target = starts_and_targets(5, 1)
    end = relative(SHOWN.ee_pose[-1:], SHOWN.object_pose[:1])
    for frame, expected in (
        ("goal", target),
        ("object", compose(target, np.repeat(end, 5, axis=0))),
    ):
        generator = Dmp(file=file, frame=frame)
        goal = generator.goal_pose(generator.start(start, target, []), target)
        assert np.allclose(relative(goal, expected), IDENTITY, atol=1e-9)


def test_says_which_extra_is_missing(file, monkeypatch):
    monkeypatch.setitem(sys.modules, "movement_primitives.dmp", None)
    with pytest.raises(KinfeasError, match=r'pip install "kinfeas\[dmp\]"$'):
        Dmp(file=file)


@pytest.mark.parametrize("size", [1, 101, 2.5, "ten", True])
def test_refuses_sizes_out_of_range(shown, size):
    with pytest.raises(KinfeasError, match=r"must be a whole number in \[2, 100\]"):
        learn(SHOWN.time, shown, size)


def test_refuses_what_it_cannot_follow(file):
    with pytest.raises(KinfeasError, match="frame must be 'goal' or 'object' here, not 'world'"):
        Dmp(file=file, frame="world")
    with pytest.raises(KinfeasError, match=r"none\.csv: cannot be read: No such file"):
        Dmp(file="none.csv")
    names = ["max_velocity", "max_angular_velocity"]
    check_numbers(lambda **given: Dmp(file=file, **given), names)
