import numpy as np

from kinfeas.core.checks import CheckedMotion
from kinfeas.core.spatial import distance
from kinfeas.plugins.linear import Linear
from kinfeas.testing.trial import Trial, sample_motions


class Fades(Linear):
    """Loses itself on the way."""

    def start(self, ee_pose, target_pose, rngs):
        return {**super().start(ee_pose, target_pose, rngs), "left": np.full(len(ee_pose), 3.0)}

    def twist(self, state, ee_pose, target_pose, dt):
        twist, after = super().twist(state, ee_pose, target_pose, dt)
        nothing = np.where(after["left"] > 0.0, 0.0, np.nan)
        return twist + nothing[:, np.newaxis], {**after, "left": after["left"] - 1.0}


def test_motions_lead_from_their_starts_to_their_goals():
    trial = Trial(duration=90.0)
    samples = sample_motions(CheckedMotion(Linear()), trial)
    assert samples.ee_pose.shape == (901, 12, 7)
    assert samples.twist.shape == (900, 12, 6)
    assert np.array_equal(samples.ee_pose[0], trial.poses()[0])
    metres, radians = distance(samples.ee_pose[-1], samples.goal)
    assert samples.broken is None
    assert metres.max() < 0.01
    assert radians.max() < 0.05


def test_motions_that_break_are_shown_as_far_as_they_came():
    samples = sample_motions(CheckedMotion(Fades(), "fades", every_step=True), Trial())
    assert samples.ee_pose.shape == (4, 12, 7)
    assert samples.broken.startswith("motion generator fades ")
