import numpy as np
import pytest

from kinfeas.core import registry
from kinfeas.core.spatial import IDENTITY, distance
from kinfeas.scenes.demonstrate import demonstrate, load_habits
from kinfeas.scenes.exercise import EXERCISES, load_exercise
from kinfeas.viz.pictures.demonstrations import demonstrations_figure, run_motion
from kinfeas.viz.pictures.style import png


@pytest.mark.parametrize("name", EXERCISES)
def test_a_picture_shows_what_was_demonstrated_beside_what_was_learned(name):
    exercise = load_exercise(name)
    figure = demonstrations_figure(name, exercise, demonstrate(exercise, load_habits(), 2, seed=0))
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    assert titles[0] == f"2 demonstrations, the {name} in as many places"
    assert png(figure, dpi=30).startswith(b"\x89PNG")


def test_a_motion_runs_until_all_arrive():
    start = np.tile(IDENTITY, (2, 1))
    target = start + np.array([[0.1], [0.3]]) * [1.0, 0, 0, 0, 0, 0, 0]
    path = run_motion(registry.build("kinfeas.motion_generators", "linear", {}), start, target)
    assert distance(path[-1], target)[0].max() < 1e-3
    assert distance(path[-2], target)[0].max() >= 1e-3
