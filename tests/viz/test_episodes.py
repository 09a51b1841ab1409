from dataclasses import replace

import numpy as np
import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.io.run_log import REACHED, About, Record
from kinfeas.viz.replay import as_recording


@pytest.fixture
def record(hsr):
    def make(t=40, event=REACHED):
        joints = tuple(joint.name for joint in hsr.arm)
        pose = np.zeros((t, 7))
        pose[:, 0], pose[:, 6] = np.linspace(0.0, 1.0, t), 1.0
        home = np.tile(hsr.home["home"], (t, 1))
        subgoal = (np.arange(t) * 2) // t
        goal = pose[-1] + subgoal[:, np.newaxis] * [0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0]
        return Record(
            About("hsr", "two", "pretrained", "analytic", 0.02, joints, "now"),
            0.02 * np.arange(t), np.full(t, np.nan), pose, home, pose + 0.0, goal,
            np.zeros((t, 6)), home, np.arange(t) % 7 > 0, subgoal,
            ("start", *[""] * (t - 2), event)[-t:],
        )  # fmt: skip

    return make


def test_a_record_is_an_episode(hsr, record):
    episode = as_recording(record(), hsr)
    assert episode.reached
    assert episode.goals.tolist() == [[1, 0, 0, 0, 0, 0, 1], [1, 1, 0, 0, 0, 0, 1]]
    assert episode.ee_pose.shape == (40, 7)
    assert not as_recording(record(event=""), hsr).reached
    assert as_recording(record(event=f"{REACHED}, task done"), hsr).reached
    line = (0.5, 0.1, 0.3, 0.2, 0.2, 0.0, 0.4, 1.0, 0.1, 0.0, 2.0)
    among = as_recording(replace(record(), about=replace(record().about, solids=(line,))), hsr)
    assert among.solids.table.tolist() == [list(line)]
    other = replace(record(), about=replace(record().about, joints=("a", "b")))
    with pytest.raises(KinfeasError, match="joints a, b"):
        as_recording(other, hsr)
