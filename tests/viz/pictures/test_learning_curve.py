from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinfeas.core import registry
from kinfeas.core.errors import KinfeasError
from kinfeas.envs.world import World, WorldConfig
from kinfeas.evaluation.recording import record_episodes
from kinfeas.policies.baselines.follow_ee import FollowEe
from kinfeas.robots.loading import load_robot
from kinfeas.viz.pictures.episodes import episodes_figure, moments
from kinfeas.viz.pictures.learning_curve import apart, learning_curve, read_metrics
from kinfeas.viz.pictures.style import FAILURE, png

TABLE = """steps,seconds,train/success,evaluation/success
0,0.5,,
1000,30,0.25,
2000,60,0.5,0.75
"""


@pytest.fixture
def run(tmp_path):
    (tmp_path / "metrics.csv").write_text(TABLE)
    return tmp_path


def recorded(name):
    robot = load_robot(name)
    task = registry.build("kinfeas.tasks", "ggr", {})
    world = World(robot, task, WorldConfig(max_failures=9, max_seconds=15.0), seed=1)
    return robot, record_episodes(world, FollowEe(robot.base), 2)


def test_metrics_are_read_as_columns(run):
    metrics = read_metrics(run)
    np.testing.assert_array_equal(metrics["steps"], [0.0, 1000.0, 2000.0])
    np.testing.assert_array_equal(metrics["evaluation/success"], [np.nan, np.nan, 0.75])


@pytest.mark.parametrize(
    "text", [None, "", "steps,seconds\n", "a,b\n1,2\n", TABLE.replace("1000", "many")]
)
def test_a_table_that_is_none_is_an_error(tmp_path, text):
    if text is not None:
        (tmp_path / "metrics.csv").write_text(text)
    with pytest.raises(KinfeasError, match=r"metrics\.csv: no table of training metrics"):
        read_metrics(tmp_path)


def test_a_row_that_a_kill_cut_short_is_read(run):
    with (run / "metrics.csv").open("a") as file:
        file.write("3000,9")
    assert read_metrics(run)["steps"][-1] == 3000.0


def test_steps_are_written_once_where_none_are_made(run):
    with (run / "metrics.csv").open("a") as file:
        file.write("2000,180,0.5,0.8\n3000,200,0.5,0.8\n")
    figure = learning_curve(read_metrics(run), {})
    figure.canvas.draw()
    ((above,),) = (axes.child_axes for axes in figure.axes)
    labels = [label.get_text() for label in above.get_xticklabels()]
    assert labels.count("2 k") == 1
    assert "" in labels


def test_the_learning_curve_names_what_it_shows(run):
    figure = learning_curve(read_metrics(run), {"follow_ee": 0.6, "ceiling": 0.98})
    axes = figure.axes[0]
    texts = [text.get_text() for text in axes.texts]
    assert texts == ["follow_ee 60.0%", "ceiling 98.0%"]
    assert axes.get_xlabel().endswith("(min)")
    assert png(figure).startswith(b"\x89PNG")


@given(st.lists(st.floats(0.0, 1.0), max_size=6).map(sorted))
def test_labels_keep_apart(values):
    placed = apart(values, 0.05)
    assert all(new >= old for old, new in zip(values, placed, strict=True))
    assert all(b - a >= 0.05 - 1e-9 for a, b in pairwise(placed))


@pytest.mark.parametrize("name", ["pr2", "tiago", "hsr"])
def test_episodes_are_drawn_from_two_sides(name):
    robot, recordings = recorded(name)
    figure = episodes_figure(robot, recordings)
    assert len(figure.axes) == 4
    for recording, top in zip(recordings, figure.axes[2:], strict=True):
        failed = [line for line in top.lines if line.get_color() == FAILURE]
        assert len(failed[0].get_xdata()) == int(np.sum(~recording.feasible))
        assert (top.get_xlabel(), top.get_ylabel()) == ("x (m)", "y (m)")
        assert top.get_aspect() == 1.0
    assert png(figure).startswith(b"\x89PNG")


def test_moments_begin_and_end_with_the_episode():
    _, recordings = recorded("pr2")
    for recording in recordings:
        at = moments(recording)
        assert at[0] == 0
        assert 1 <= len(at) <= 4
        way_left = recording.base_pose[at[-1], :2] - recording.base_pose[-1, :2]
        assert np.linalg.norm(way_left) < 1e-9
