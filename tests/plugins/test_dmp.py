"""The movement primitive reproduces its demonstration, and moves as the library's."""

import numpy as np
import pytest

from kinfeas.core.spatial import IDENTITY, relative
from kinfeas.plugins.dmp import Dmp
from kinfeas.plugins.replay import resampled
from tests.plugins.conftest import SHOWN, apart, run, starts_and_targets

FAST = {"max_velocity": 10.0, "max_angular_velocity": 10.0}
IN_END = relative(SHOWN.ee_pose, np.broadcast_to(SHOWN.ee_pose[-1], SHOWN.ee_pose.shape))


@pytest.fixture(scope="module")
def library():
    """The module that learns the force, an extra that is built from source."""
    return pytest.importorskip("movement_primitives.dmp", reason="the extra dmp is not installed")


def test_reproduces_the_demonstration_in_its_time_or_slower_within_limits(library, files):
    fast, _, _ = run(Dmp(file=files["shown"], **FAST), IN_END[:1], IDENTITY[np.newaxis], 10.0, 0.01)
    moments = np.arange(0.0, SHOWN.time[-1], 0.2)
    expected = resampled(SHOWN.time, IN_END, moments / SHOWN.time[-1])
    metres, radians = apart(fast[np.round(moments / 0.01).astype(int), 0], expected)
    assert metres.max() < 5e-3
    assert radians.max() < 0.02
    slow, _, _ = run(Dmp(file=files["shown"]), IN_END[:1], IDENTITY[np.newaxis], 40.0)
    metres = np.linalg.norm(slow[:, 0, np.newaxis, :3] - fast[:, 0, :3], axis=-1)
    assert metres.min(axis=1).max() < 5e-3


def test_moves_as_the_library_does(library, files):
    duration, moments = SHOWN.time[-1], np.linspace(0.0, 1.0, 201)
    model = library.CartesianDMP(1.0, 1.0 / 200, 25, smooth_scaling=True)
    wxyz = [0, 1, 2, 6, 3, 4, 5]
    model.imitate(moments, resampled(SHOWN.time, IN_END, moments)[:, wxyz])
    _, (other,) = starts_and_targets(1, 0)
    start = np.concatenate([[0.3, -0.2, 0.4], other[3:]])
    model.configure(start_y=start[wxyz], goal_y=IDENTITY[wxyz])
    _, theirs = model.open_loop(run_t=1.0)
    generator = Dmp(file=files["shown"], **FAST)
    poses, _, _ = run(generator, start[np.newaxis], IDENTITY[np.newaxis], duration, duration / 1000)
    ours = poses[::5, 0][:, wxyz]
    theirs = theirs[: len(ours)]
    assert np.linalg.norm((ours - theirs)[:, :3], axis=1).max() < 1e-2
    dots = np.abs(np.sum(ours[:, 3:] * theirs[:, 3:], axis=1))
    assert 2.0 * np.arccos(np.minimum(dots.min(), 1.0)) < 0.03
