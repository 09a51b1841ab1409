from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from kinfeas.config import PluginSpec
from kinfeas.envs.world import World, evaluation_world
from kinfeas.policies.loading import load_policy
from kinfeas.tasks.loading import load_task
from kinfeas.viz.film import captioned, count_pictures, result, write_film
from kinfeas.viz.pages import physics_html
from kinfeas.viz.physics_film import make_film
from kinfeas.viz.style import FAILURE


def start(robot, task, seconds, engine, **changes):
    config = replace(evaluation_world(engine, robot.name), max_seconds=seconds, **changes)
    return World(robot, load_task(task), config, 1), load_policy("follow_ee", robot)


@pytest.fixture(scope="module", params=["pybullet", "mujoco"])
def engine(request):
    pytest.importorskip(request.param)
    return request.param


@pytest.fixture(scope="module")
def film(hsr, engine):
    """One second in which the task is not done."""
    world, policy = start(hsr, "door", 1, engine)
    yield make_film(world, policy, 0)
    world.close()


def test_a_film_has_the_episode(film):
    recording = film.recording
    assert len(recording.times) == len(film.moments) == len(recording.desired)
    assert recording.times[-1] == pytest.approx(1.0)
    assert np.abs(recording.ee_pose[0] - recording.desired[0]).max() < 0.01
    assert len(recording.goals) == 1
    assert result(recording) == ("goal not reached, task not done", False)


def test_paths_are_true_positions_without_sensor_errors(hsr, engine):
    lost = PluginSpec("localisation", {"drift": 0.5, "turn_drift": 0.5})
    world, policy = start(hsr, "ggr", 1, engine, adapters=(lost,))
    film = make_film(world, policy, 0)
    base, hand = (film.links.index(("", link)) for link in (hsr.base.frame, hsr.ee_frame))
    recording, poses = film.recording, np.stack(film.moments)
    np.testing.assert_allclose(recording.base_pose[:, :2], poses[:, base, :2], atol=1e-7)
    np.testing.assert_allclose(recording.ee_pose[:, :3], poses[:, hand, :3], atol=1e-6)
    world.close()


def count_red(image):
    red = np.array([int(FAILURE[i : i + 2], 16) for i in (1, 3, 5)])
    return np.sum(np.abs(np.asarray(image, dtype=int) - red).sum(axis=-1) < 40)


def test_failures_are_red(film):
    count, red = len(film.moments), []
    for feasible in (np.ones(count, dtype=bool), np.zeros(count, dtype=bool)):
        shown = replace(film, recording=replace(film.recording, feasible=feasible))
        red.append(count_red(shown.picture(count - 2)))
    assert red[0] == 0
    assert red[1] > 10


@pytest.mark.parametrize(
    ("reached", "done", "succeeded"),
    [(True, None, True), (False, None, False), (True, True, True), (True, False, False)],
)
def test_the_last_picture_has_the_result(film, reached, done, succeeded):
    feasible = np.ones_like(film.recording.feasible)
    recording = replace(film.recording, reached=reached, task_done=done, feasible=feasible)
    assert result(recording)[1] is succeeded
    last, shown = len(film.moments) - 1, replace(film, recording=recording)
    assert count_red(captioned(shown, last - 1)) == 0
    assert bool(count_red(captioned(shown, last))) is not succeeded


@pytest.mark.parametrize("suffix", [".gif", ".png", ".mp4"])
def test_films_are_written(film, tmp_path, suffix):
    if suffix == ".mp4":
        av = pytest.importorskip("av")
    path, told = tmp_path / f"film{suffix}", []
    write_film(film, path, told.append)
    assert sum(told) == count_pictures(film, path)
    if suffix == ".mp4":
        with av.open(str(path)) as file:
            shown = [frame.width for frame in file.decode(video=0)]
        assert set(shown) == {480}
        assert len(shown) > sum(told)  # the last picture stays
        return
    with Image.open(path) as image:
        assert getattr(image, "n_frames", 1) == (sum(told) if suffix == ".gif" else 1)
        assert image.size == ((480, 360) if suffix == ".gif" else (2 * 480 + 6, 2 * 360 + 6))


def test_a_page_is_self_contained(film):
    pytest.importorskip("viser")
    page = physics_html(film)
    assert page.lstrip().lower().startswith("<!doctype html")
    assert len(page) < 3_000_000
    assert 'src="http' not in page
