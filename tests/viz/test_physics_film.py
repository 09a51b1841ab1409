from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from kinfeas.config import PluginSpec
from kinfeas.envs.world import World, evaluation_world
from kinfeas.policies.loading import load_policy
from kinfeas.tasks.loading import load_task
from kinfeas.viz.film import count_pictures, result, write_film
from kinfeas.viz.physics_film import make_film


def start(robot, task, seconds, engine, **changes):
    config = replace(evaluation_world(engine, robot.name), max_seconds=seconds, **changes)
    return World(robot, load_task(task), config, 1), load_policy("follow_ee", robot)


@pytest.fixture(scope="module")
def film(hsr, engine):
    world, policy = start(hsr, "door", 1, engine)
    yield make_film(world, policy, 0)
    world.close()


def test_a_film_has_the_episode(film):
    recording = film.recording
    assert len(recording.times) == len(film.moments) == len(recording.desired)
    assert recording.times[-1] == pytest.approx(1.0)
    assert np.abs(recording.ee_pose[0] - recording.desired[0]).max() < 0.01
    assert not result(recording)[1]
    pytest.importorskip("viser")
    from kinfeas.viz.pages import physics_html

    assert 'src="http' not in physics_html(film)


def test_paths_are_true_positions_without_sensor_errors(hsr, engine):
    lost = PluginSpec("localisation", {"drift": 0.5, "turn_drift": 0.5})
    world, policy = start(hsr, "ggr", 1, engine, adapters=(lost,))
    film = make_film(world, policy, 0)
    base, hand = (film.links.index(("", link)) for link in (hsr.base.frame, hsr.ee_frame))
    recording, poses = film.recording, np.stack(film.moments)
    np.testing.assert_allclose(recording.base_pose[:, :2], poses[:, base, :2], atol=1e-7)
    np.testing.assert_allclose(recording.ee_pose[:, :3], poses[:, hand, :3], atol=1e-6)
    world.close()


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
