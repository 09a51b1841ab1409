from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from kinfeas.config import PluginSpec
from kinfeas.core.spatial import IDENTITY
from kinfeas.envs.world import World, evaluation_world
from kinfeas.policies.loading import load_policy
from kinfeas.robots.urdf import Shape
from kinfeas.scenes.scene import read_scene
from kinfeas.tasks.loading import load_task
from kinfeas.viz.replay import result, run_episode


def start(robot, task, seconds, engine, **changes):
    config = replace(evaluation_world(engine, robot.name), max_seconds=seconds, **changes)
    return World(robot, load_task(task), config, 1), load_policy("follow_ee", robot)


@pytest.fixture(scope="module")
def replay(hsr, engine):
    world, policy = start(hsr, "door", 0.3, engine)
    yield run_episode(world, policy, 0)
    world.close()


def test_a_replay_has_the_episode(replay):
    recording = replay.recording
    assert len(replay.recording.times) == len(recording.desired)
    assert recording.times[-1] == pytest.approx(0.3)
    assert np.abs(recording.ee_pose[0] - recording.desired[0]).max() < 0.01
    assert not result(recording)[1]
    assert recording.solids is None and "door_shelf" in recording.scene.objects


def test_pages_are_self_contained(replay):
    pytest.importorskip("viser")
    from kinfeas.viz.pages import replay_html, scene_html

    for html in (scene_html(read_scene("room")), replay_html(replay)):
        assert html.lstrip().lower().startswith("<!doctype html")
        assert "<title>kinfeas: " in html
        assert not any(place in html for place in ('src="http', "src='http", 'href="http'))


def test_paths_are_true_positions_without_sensor_errors(hsr, engine):
    lost = PluginSpec("localisation", {"drift": 0.5, "turn_drift": 0.5})
    world, policy = start(hsr, "ggr", 1, engine, adapters=(lost,))
    replay = run_episode(world, policy, 0)
    recording = replay.recording
    links = [replay.links(moment) for moment in range(len(replay.recording.times))]
    base, ee = (
        np.stack([poses["", link] for poses in links]) for link in (hsr.base.frame, hsr.ee_frame)
    )
    np.testing.assert_allclose(recording.base_pose[:, :2], base[:, :2], atol=1e-7)
    np.testing.assert_allclose(recording.ee_pose[:, :3], ee[:, :3], atol=1e-6)
    world.close()


def test_a_camera_draws_shapes_where_the_view_projects_them():
    pytest.importorskip("pybullet")
    from kinfeas.backends.pybullet.camera import Camera, View

    corner = np.array([1.0, 2.0, 1.0])
    view = View.of_box(-corner, corner, 0.7, 0.5)
    camera = Camera([(Shape("sphere", (0.1,), IDENTITY), "#ff0000")])
    for point in corner * [[1, 1, -1], [1, -1, 1], [-1, 1, -1], [0, 0, 0]]:
        picture = camera.picture([np.array([*point, 0.0, 0.0, 0.0, 1.0])], view).astype(int)
        rows, columns = np.nonzero(picture[..., 0] - picture[..., 1] > 60)
        (pixel,) = view.pixels(point[np.newaxis])
        assert np.abs(pixel - [columns.mean(), rows.mean()]).max() < 3.0
    camera.close()


@pytest.mark.parametrize("suffix", [".gif", ".png", ".mp4"])
def test_films_are_written(replay, tmp_path, suffix):
    pytest.importorskip("pybullet")
    from kinfeas.viz.film import write_film

    if suffix == ".mp4":
        av = pytest.importorskip("av")
    path, counts = tmp_path / f"film{suffix}", []
    write_film(replay, path, counts.append)
    assert sum(counts) == pytest.approx(1.0)
    if suffix == ".mp4":
        with av.open(str(path)) as file:
            widths = [frame.width for frame in file.decode(video=0)]
        assert set(widths) == {480}
        assert len(widths) > len(counts)  # the last picture stays
        return
    with Image.open(path) as image:
        assert getattr(image, "n_frames", 1) == (len(counts) if suffix == ".gif" else 1)
        assert image.size == ((480, 360) if suffix == ".gif" else (2 * 480 + 6, 2 * 360 + 6))
