from dataclasses import replace

import numpy as np
import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.io.run_log import REACHED, About, Record
from kinfeas.robots.loading import load_robot
from kinfeas.viz.deployed_run import recording, replay_figure, scene_of
from kinfeas.viz.pages.deployed_run import moments, replay_html
from kinfeas.viz.pictures.style import png

PR2 = load_robot("pr2")


def record(t=40, event=REACHED):
    joints = tuple(joint.name for joint in PR2.arm)
    pose = np.zeros((t, 7))
    pose[:, 0], pose[:, 6] = np.linspace(0.0, 1.0, t), 1.0
    home = np.tile(PR2.home["home"], (t, 1))
    subgoal = (np.arange(t) * 2) // t
    goal = pose[-1] + subgoal[:, np.newaxis] * [0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    return Record(
        About("pr2", "two", "pretrained", "analytic", 0.02, joints, "now"),
        0.02 * np.arange(t), np.full(t, np.nan), pose, home, pose + 0.0, goal,
        np.zeros((t, 6)), home, np.arange(t) % 7 > 0, subgoal,
        ("start", *[""] * (t - 2), event)[-t:],
    )  # fmt: skip


def test_a_record_is_an_episode():
    episode = recording(record(), PR2)
    assert episode.reached
    assert episode.goals.tolist() == [[1, 0, 0, 0, 0, 0, 1], [1, 1, 0, 0, 0, 0, 1]]
    assert episode.ee_pose.shape == (40, 7)
    assert not recording(record(event=""), PR2).reached


def test_draws_the_furniture_near_by_where_the_episode_put_it():
    run = record()
    place = (0.5, 0.3, 0.115, 0.0, 0.0, 0.0, 1.0)
    about = replace(run.about, scene="room", objects={"box": place})
    around = replace(run, about=about)
    assert scene_of(run) is None
    assert scene_of(around).objects["box"].pose.tolist() == list(place)
    bare, furnished = (replay_figure(one, PR2).axes[1].patches for one in (run, around))
    assert len(furnished) > len(bare)


def test_a_run_whose_task_was_done_was_reached():
    assert recording(record(event=f"{REACHED}, task done"), PR2).reached


@pytest.mark.parametrize("t", [1, 40])
def test_draws_a_run_of_any_length(t):
    assert png(replay_figure(record(t), PR2)).startswith(b"\x89PNG")


def test_the_page_stands_alone():
    pytest.importorskip("viser")
    run = record(30)
    page = replay_html(recording(run, PR2), PR2, run.time)
    assert page.lstrip().lower().startswith("<!doctype html>")


def test_refuses_another_robots_record():
    run = record()
    other = replace(run, about=replace(run.about, joints=("a", "b")))
    with pytest.raises(KinfeasError, match="of the joints a, b, but the arm of robot 'pr2' has"):
        recording(other, PR2)


def test_shows_few_moments_and_the_last_one():
    times = np.arange(0.0, 1000.0, 0.02)
    shown = moments(times)
    assert len(shown) <= 1201
    assert shown[0] == 0
    assert shown[-1] == len(times) - 1
    assert np.all(np.diff(shown) > 0)
    assert moments(np.array([3.0])).tolist() == [0]
