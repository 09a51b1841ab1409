from dataclasses import replace

import numpy as np
import pytest

from kinfeas.core import registry
from kinfeas.core.errors import KinfeasError
from kinfeas.envs.world import World, WorldConfig
from kinfeas.evaluation.recording import record_episodes
from kinfeas.io.run_log import REACHED, About, Record
from kinfeas.policies.loading import load_policy
from kinfeas.viz.episodes import episodes_figure
from kinfeas.viz.replay import as_recording
from kinfeas.viz.style import FAILURE


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


def test_episodes_are_drawn_from_the_side_and_from_above(hsr, recordings):
    figure = episodes_figure(hsr, recordings)
    tops = [axes for axes in figure.axes if axes.name == "rectilinear"]
    assert len(figure.axes) == 4
    assert any((~recording.feasible).any() for recording in recordings)
    for recording, top in zip(recordings, tops, strict=True):
        failed = [line for line in top.lines if line.get_color() == FAILURE]
        assert sum(len(line.get_xdata()) for line in failed) == int(np.sum(~recording.feasible))


def test_furniture_is_drawn_where_the_episode_puts_it(hsr):
    task = registry.build("kinfeas.tasks", "pick_place", {})
    world = World(hsr, task, WorldConfig(max_seconds=3.0), seed=1)
    (one,) = record_episodes(world, load_policy("follow_ee", hsr), 1)
    table = one.scene.objects["place_table"].pose
    far = replace(one, scene=None)
    near = replace(one, base_pose=np.concatenate([one.base_pose, table[np.newaxis]]))
    near = replace(near, **{
        name: np.concatenate([getattr(one, name), getattr(one, name)[-1:]])
        for name in ("joint_positions", "desired", "ee_pose", "feasible")
    })  # fmt: skip
    tops = [episodes_figure(hsr, [shown]).axes[1] for shown in (far, near)]
    plain, furnished = ([patch.get_xy() for patch in top.patches] for top in tops)
    assert len(furnished) > len(plain)
    assert any(np.allclose(np.ptp(xy, axis=0), 0.75) for xy in furnished)


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
