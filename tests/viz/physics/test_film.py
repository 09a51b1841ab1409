from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from kinfeas.config import PluginSpec
from kinfeas.core.errors import KinfeasError
from kinfeas.policies.loading import load_policy
from kinfeas.robots.loading import load_robot
from kinfeas.tasks.loading import load_task

pytest.importorskip("pybullet")

from kinfeas.backends.pybullet.camera import link_poses, show_moment
from kinfeas.envs.physics import physics_config
from kinfeas.evaluation.physics.world import PhysicsTrial, PhysicsWorld
from kinfeas.viz.pages.film import film_html, label
from kinfeas.viz.physics.film import check_film_path, count_pictures, make_film, write_film
from kinfeas.viz.physics.recording import record
from kinfeas.viz.pictures.style import FAILURE


@pytest.fixture(scope="module")
def film():
    """Three seconds of a TIAGo that begins to fail."""
    robot = load_robot("tiago")
    settings = physics_config(robot, ["world.max_seconds=3"]).world
    trial = PhysicsTrial(robot, load_task("door"), 1, 1, settings)
    world = PhysicsWorld(trial)
    yield make_film(world, trial, record(world, trial, load_policy("follow_ee", robot), 0))
    world.close()


def test_a_recording_holds_the_episode(film):
    recording = film.recording
    count = len(recording.times)
    assert count == len(recording.moments) == len(recording.desired) == len(recording.failures)
    assert np.all(np.diff(recording.times) > 0.0)
    assert recording.times[-1] == pytest.approx(3.0)
    assert np.abs(recording.ee[0] - recording.desired[0]).max() < 0.01
    assert len(recording.goals) == 1
    assert not recording.reached
    assert not recording.done


def test_the_same_episode_is_recorded_again(film):
    robot = load_robot("tiago")
    settings = physics_config(robot, ["world.max_seconds=1"]).world
    trial = PhysicsTrial(robot, load_task("door"), 1, 1, settings)
    world = PhysicsWorld(trial)
    again = record(world, trial, load_policy("follow_ee", robot), 0)
    world.close()
    count = len(again.times) - 1  # the end is kept, too, wherever it lies
    np.testing.assert_array_equal(again.ee[:count], film.recording.ee[:count])
    assert again.moments[:count] == film.recording.moments[:count]


def test_paths_are_the_true_ones_whatever_sensors_say():
    """Base and EE are where the pictures show them, in the midst of a policy's errors."""
    robot = load_robot("hsr")
    lost = PluginSpec("localisation", {"drift": 0.5, "turn_drift": 0.5})
    settings = replace(physics_config(robot, ["world.max_seconds=1"]).world, adapters=(lost,))
    trial = PhysicsTrial(robot, load_task("ggr"), 1, 1, settings)
    world = PhysicsWorld(trial)
    recording = record(world, trial, load_policy("follow_ee", robot), 0)
    body = world.stage.backend.sims[0].body
    for moment, base, ee in zip(recording.moments, recording.base, recording.ee, strict=True):
        show_moment(body.physics, moment)
        seen = link_poses(body.physics, [(body.body, body.links[robot.ee_frame])])
        np.testing.assert_allclose(base[:2], body.planar()[:2], atol=1e-9)
        np.testing.assert_allclose(ee, seen[0, :3], atol=1e-6)
    world.close()


def test_robot_and_goal_are_in_the_picture_from_inside_the_room(film):
    recording, framing = film.recording, film.framing
    assert framing.eye.shape == framing.target.shape == recording.base.shape
    assert np.abs(framing.eye[:, :2]).max() < 5.0
    assert np.all(framing.eye[:, 2] > 0.5)
    # The camera follows calmly.
    assert np.linalg.norm(np.diff(framing.eye, axis=0), axis=1).max() < 0.1
    assert replace(film, size=(48, 36)).picture(0).size == (48, 36)


def count_red(image):
    red = np.array([int(FAILURE[i : i + 2], 16) for i in (1, 3, 5)])
    return np.sum(np.abs(np.asarray(image, dtype=int) - red).sum(axis=-1) < 40)


def test_failures_are_red(film):
    count, last = len(film.recording.times), len(film.recording.times) - 2
    none, some = np.zeros(count, dtype=int), np.ones(count, dtype=int)
    pictures = [
        replace(film, recording=replace(film.recording, failures=failures)).picture(last)
        for failures in (none, some)
    ]
    assert count_red(pictures[0]) == 0
    assert count_red(pictures[1]) > 10


@pytest.mark.parametrize(
    ("reached", "done", "outcome", "succeeded"),
    [
        (True, None, "goal reached", True),
        (False, None, "goal not reached", False),
        (True, True, "goal reached, task done", True),
        (True, False, "goal reached, task not done", False),
        (False, True, "goal not reached, task done", False),
    ],
)
def test_the_end_says_what_the_episode_came_to(film, reached, done, outcome, succeeded):
    none = np.zeros_like(film.recording.failures)
    came_to = replace(film.recording, reached=reached, done=done, failures=none)
    assert (came_to.outcome, came_to.succeeded) == (outcome, succeeded)
    shown = replace(film, recording=came_to)
    last = len(came_to.times) - 1
    assert count_red(shown.picture(last - 1)) == 0
    assert bool(count_red(shown.picture(last))) is not succeeded
    said = []
    scene = SimpleNamespace(add_label=lambda _, text, **__: said.append(text))
    label(SimpleNamespace(scene=scene), shown)
    assert said == [f"no failure, {outcome}"]


@pytest.mark.parametrize("suffix", [".gif", ".png", ".mp4"])
def test_films_are_written(film, tmp_path, suffix):
    if suffix == ".mp4":
        av = pytest.importorskip("av")
    path, told = tmp_path / f"film{suffix}", []
    write_film(replace(film, size=(96, 72)), path, told.append)
    assert sum(told) == count_pictures(film, path)
    if suffix == ".mp4":
        with av.open(str(path)) as file:
            shown = [frame.width for frame in file.decode(video=0)]
        assert set(shown) == {96}
        assert len(shown) > sum(told)  # the end stays for a while
        return
    with Image.open(path) as image:
        assert getattr(image, "n_frames", 1) == (sum(told) if suffix == ".gif" else 1)
        assert image.size == ((96, 72) if suffix == ".gif" else (2 * 96 + 6, 2 * 72 + 6))


def test_a_film_that_is_not_finished_leaves_the_one_before(film, tmp_path, monkeypatch):
    def cut(_, path, __):
        path.write_bytes(b"the first bytes")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("kinfeas.viz.physics.film._write_gif", cut)
    path = tmp_path / "film.gif"
    path.write_bytes(b"old")
    with pytest.raises(KinfeasError, match=r"film.gif: cannot be written: No space left on device"):
        write_film(film, path)
    assert path.read_bytes() == b"old"


def test_a_page_stands_alone(film):
    pytest.importorskip("viser")
    page = film_html(film)
    assert page.lstrip().lower().startswith("<!doctype html")
    assert len(page) < 3_000_000
    for elsewhere in ('src="http', "src='http", 'href="http'):
        assert elsewhere not in page


def test_other_endings_are_a_clear_error(tmp_path):
    with pytest.raises(KinfeasError, match=r"must end in one of: \.gif, \.mp4, \.png"):
        check_film_path(tmp_path / "film.avi")
