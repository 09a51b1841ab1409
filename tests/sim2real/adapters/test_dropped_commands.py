import numpy as np
import pytest

from kinfeas.config import PluginSpec
from kinfeas.control.adapters import wrap
from kinfeas.core.errors import KinfeasError
from kinfeas.sim2real.adapters.dropped_commands import DroppedCommands


def test_what_is_lost_leaves_the_last_command_in_force(rig, drive):
    lossy = rig(DroppedCommands, n=30, share=0.3)
    twists = drive(200, n=30)
    lossy.run(twists)
    came = np.all(lossy.passed == twists, axis=2)
    assert came.mean() == pytest.approx(0.7, abs=0.03)
    held = np.concatenate([np.zeros((1, 30, 6)), lossy.passed[:-1]])
    np.testing.assert_array_equal(lossy.passed[~came], held[~came])


def test_losses_are_independent_of_each_other(rig, drive):
    lossy = rig(DroppedCommands, n=200, share=0.5)
    twists = drive(200, n=200)
    lossy.run(twists)
    came = np.all(lossy.passed == twists, axis=2).astype(float) - 0.5
    assert abs(np.mean(came[1:] * came[:-1])) < 0.005
    assert abs(np.mean(came[:, 1:] * came[:, :-1])) < 0.005


@pytest.mark.parametrize("share", [-0.1, 1.1])
def test_a_share_is_one(pr2, share):
    with pytest.raises(KinfeasError, match=r"share is .*, must be a finite number in \[0, 1\]"):
        wrap(object(), [PluginSpec("dropped_commands", {"share": share})], pr2)


def test_all_may_be_lost(rig, drive):
    deaf = rig(DroppedCommands, share=1.0)
    deaf.run(drive(20), targets=np.ones((20, 1, 7)))
    np.testing.assert_array_equal(deaf.passed, 0.0)
    np.testing.assert_array_equal(deaf.sent, 0.0)
