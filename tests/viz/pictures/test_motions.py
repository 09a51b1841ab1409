import numpy as np
import pytest

from kinfeas.core.checks.motion import CheckedMotion
from kinfeas.plugins.linear import Linear
from kinfeas.testing.trial import Samples, Trial, sample_motions
from kinfeas.viz.pictures.motions import motion_figure
from kinfeas.viz.pictures.style import png


@pytest.mark.parametrize("limit", [0.1, None])
def test_paths_speeds_and_limits_are_drawn(limit):
    trial = Trial(duration=5.0, max_velocity=limit)
    samples = sample_motions(CheckedMotion(Linear()), trial)
    figure = motion_figure("linear", samples, trial)
    above, _, speed, _ = figure.axes
    assert len(above.lines) == 3 * 12
    assert len(speed.lines) == 12 + (limit is not None)
    assert png(figure).startswith(b"\x89PNG")


def test_the_time_axis_ends_soon_after_the_last_motion():
    moving = np.zeros((100, 2, 6))
    moving[:20, 0, 0] = moving[:40, 1, 5] = 0.1
    moving[40:, 1, 5] = 1e-6  # not to be seen
    poses = np.tile([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], (101, 2, 1))
    trial = Trial(duration=100.0, dt=1.0)
    for twist, end in ((moving, 39.0), (np.zeros_like(moving), 99.0)):
        _, _, *speeds = motion_figure("mine", Samples(poses, twist, poses[0], None), trial).axes
        for axes in speeds:
            assert end < axes.get_xlim()[1] < 1.1 * end


def test_motions_that_broke_at_once_are_drawn_with_the_reason():
    poses = np.tile([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], (1, 2, 1))
    samples = Samples(poses, np.zeros((0, 2, 6)), poses[0], "it broke")
    figure = motion_figure("mine", samples, Trial())
    assert "it broke" in figure.get_suptitle()
    assert png(figure)
