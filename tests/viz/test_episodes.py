from dataclasses import replace

import numpy as np
import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.core.solids import Solids
from kinfeas.io.run_log import REACHED, About, Record
from kinfeas.viz.episodes import (
    EpisodeFilm,
    as_recording,
    episodes_figure,
    record_figure,
    scene_of,
)
from kinfeas.viz.shapes import corners, solid_shapes
from kinfeas.viz.style import FAILURE, png


@pytest.fixture
def record(hsr):
    """Return a function that makes a recorded run of t control periods."""

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
        assert (top.get_xlabel(), top.get_ylabel()) == ("x (m)", "y (m)")
        assert top.get_aspect() == 1.0
    assert png(figure).startswith(b"\x89PNG")


def test_a_film_shows_failures_in_red(hsr, recordings):
    recording = next(one for one in recordings if not one.feasible.all())
    red = np.array([int(FAILURE[i : i + 2], 16) for i in (1, 3, 5)])

    def count(film):
        image = np.asarray(film.picture(len(recording.times) - 2), dtype=int)[:300]
        return int(np.sum(np.abs(image - red).sum(axis=-1) < 40))

    film = EpisodeFilm(recording, "hsr", hsr)
    fine = replace(film, recording=replace(recording, feasible=recording.feasible | True))
    assert film.picture(0).size == (480, 360)
    assert count(film) > 5
    assert count(fine) == 0


def test_solids_are_drawn_where_they_stand(hsr, recordings):
    solids = Solids.empty(1, 3)
    solids.size[0, 1:] = [[0.2, 0.2, 0.0, 0.4], [0.3, 0.5, 0.0, 2.0]]
    solids.pose[0, 1:, :2] = recordings[0].base_pose[0, :2] + [[0.5, 0.0], [-0.5, 0.0]]
    solids.cylinder[0, 1], solids.velocity[0, 1], solids.span[0, 1] = True, [0.0, 0.01], 1.0
    among = replace(recordings[0], solids=solids)
    drawn = solid_shapes(among.solids_at(30))
    assert {place: one.shape.kind for place, one in drawn.items()} == {1: "cylinder", 2: "box"}
    np.testing.assert_array_equal(corners([drawn[2]])[:, 2].max(), 2.0)
    moved = solids.centre[0, 1, :3] + [0.0, 0.01 * among.times[30], 0.0]
    np.testing.assert_allclose(drawn[1].shape.pose[:3], moved, atol=1e-12)
    bare, around = (episodes_figure(hsr, [one]).axes[1].patches for one in (recordings[0], among))
    assert len(around) == len(bare) + 4  # where they began, and at the end
    film = EpisodeFilm(among, "hsr", hsr)
    assert film.picture(0) != replace(film, recording=recordings[0]).picture(0)


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


def test_furniture_is_drawn_where_the_episode_placed_it(hsr, record):
    run, place = record(), (0.5, 0.3, 0.115, 0.0, 0.0, 0.0, 1.0)
    around = replace(run, about=replace(run.about, scene="room", objects={"box": place}))
    assert scene_of(run) is None
    assert scene_of(around).objects["box"].pose.tolist() == list(place)
    bare, furnished = (record_figure(one, hsr).axes[1].patches for one in (run, around))
    assert len(furnished) > len(bare)
    assert png(record_figure(record(1), hsr)).startswith(b"\x89PNG")
