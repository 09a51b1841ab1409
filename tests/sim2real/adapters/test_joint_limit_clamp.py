import numpy as np
import pytest

from kinfeas.config import PluginSpec
from kinfeas.control.adapters import wrap
from kinfeas.core.errors import KinfeasError
from kinfeas.sim2real.adapters.joint_limit_clamp import JointLimitClamp


@pytest.mark.parametrize("margin", [0.0, 0.05])
def test_targets_stay_within_the_limits(rig, drive, pr2, margin):
    clamped = rig(JointLimitClamp, margin=margin)
    sent, twists = np.random.default_rng(0).uniform(-3.0, 3.0, (50, 1, 7)), drive(50)
    clamped.run(twists, targets=sent)
    lower, upper = (np.array([getattr(j, end) for j in pr2.arm]) for end in ("lower", "upper"))
    within = (sent >= lower + margin) & (sent <= upper - margin)
    np.testing.assert_array_equal(clamped.sent[within], sent[within])
    assert np.all(clamped.sent >= lower + margin)
    assert np.all(clamped.sent <= upper - margin)
    assert within.mean() < 0.9
    np.testing.assert_array_equal(clamped.passed, twists)


def test_a_margin_leaves_something_of_each_range(pr2):
    with pytest.raises(KinfeasError, match=r"margin is 1\.0, at most 0\.825 is half a joint"):
        wrap(object(), [PluginSpec("joint_limit_clamp", {"margin": 1.0})], pr2)
