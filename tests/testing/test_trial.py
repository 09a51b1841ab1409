import numpy as np

from kinfeas.core.checks import CheckedMotion
from kinfeas.core.spatial import distance
from kinfeas.plugins.linear import Linear
from kinfeas.testing.trial import Trial, sample_motions


def test_motions_lead_from_their_starts_to_their_goals():
    trial = Trial(duration=90.0)
    samples = sample_motions(CheckedMotion(Linear()), trial)
    assert samples.ee_pose.shape == (901, 12, 7)
    assert samples.twist.shape == (900, 12, 6)
    assert np.array_equal(samples.ee_pose[0], trial.poses()[0])
    metres, radians = distance(samples.ee_pose[-1], samples.goal)
    assert metres.max() < 0.01
    assert radians.max() < 0.05
