from dataclasses import replace

import numpy as np
import pytest

from kinfeas.core.spatial import IDENTITY, distance, make_pose, relative, rotation
from kinfeas.scenes.demonstrate import load_habits
from kinfeas.scenes.exercise import load_exercise
from kinfeas.scenes.hand import drift, fine_times, minimum_jerk, pull, reach, samples, scatter
from kinfeas.scenes.mechanism import AnalyticMechanism

HABITS = load_habits()


class Wall:
    """A handle that does not move; it counts what pulls at it."""

    def __init__(self):
        self.impulse = np.zeros(3)

    def handle_pose(self):
        return IDENTITY.copy()

    def pull(self, force, point, dt):
        self.impulse += force * dt


def test_minimum_jerk_starts_and_ends_at_rest():
    share = np.linspace(0.0, 1.0, 1001)
    way = minimum_jerk(share)
    speed = np.gradient(way, share)
    assert (way[0], way[-1]) == pytest.approx((0.0, 1.0))
    assert way[500] == pytest.approx(0.5)
    assert np.all(np.diff(way) > 0.0)
    assert speed[[0, -1]] == pytest.approx([0.0, 0.0], abs=1e-3)
    assert speed.max() == pytest.approx(1.875, rel=1e-3)


@pytest.mark.parametrize("mask", [[1.0, 1.0, 1.0], [1.0, 0.0, 1.0]])
def test_scatter_has_the_spread_it_says(mask):
    rng = np.random.default_rng(0)
    drawn = np.array([scatter(rng, 0.02, np.array(mask)) for _ in range(3000)])
    length = np.sqrt(np.sum(drawn**2, axis=1))
    assert np.sqrt(np.mean(length**2)) == pytest.approx(0.02, rel=0.1)
    assert length.max() <= 0.04 + 1e-12
    assert np.all(drawn[:, np.array(mask) == 0.0] == 0.0)


def test_drift_is_slow_and_of_the_size_it_says():
    rng, time = np.random.default_rng(0), np.arange(0.0, 30.0, 0.02)
    drawn = np.array([drift(rng, time, 0.0025) for _ in range(200)])
    assert np.all(drawn[:, 0] == 0.0)
    assert np.sqrt(np.mean(np.sum(drawn**2, axis=2))) == pytest.approx(0.0025, rel=0.1)
    assert np.abs(np.diff(drawn, axis=1)).max() / 0.02 < 0.02  # m/s


def test_durations_cover_their_range():
    rng = np.random.default_rng(0)
    ends = np.array([samples(HABITS, rng)[-1] for _ in range(300)])
    assert ends.min() >= HABITS.duration[0]
    assert ends.max() <= HABITS.duration[1]
    assert np.ptp(ends) > 2.9


def test_a_reach_leads_from_start_to_end():
    time = np.linspace(0.0, 2.0, 101)
    start = make_pose(np.zeros(3), rotation(IDENTITY))
    end = make_pose(np.array([0.2, 0.1, 0.0]), rotation(np.array([0, 0, 0, 0.6, 0, 0, 0.8])))
    path = reach(start, end, time, np.zeros((101, 3)))
    for pose, wanted in ((path[0], start), (path[-1], end)):
        assert distance(pose, wanted) == pytest.approx((0.0, 0.0), abs=1e-9)
    wander = np.full((101, 3), 0.01)
    np.testing.assert_allclose(reach(start, end, time, wander)[:, :3] - path[:, :3], 0.01)


def test_a_wall_holds_the_hand_and_feels_its_pull():
    time = np.linspace(0.0, 2.0, 101)
    wanted = np.outer(minimum_jerk(fine_times(time) / 2.0), [-0.1, 0.0, 0.05])
    wall = Wall()
    hands, _ = pull(wall, IDENTITY.copy(), wanted, HABITS, slip=0.0)
    springs = HABITS.arm_stiffness / (HABITS.arm_stiffness + HABITS.grip_stiffness)
    # In the plane two springs share the way; up and down the hand slides on the handle.
    assert hands[-1, :3] == pytest.approx([-0.1 * springs, 0.0, 0.05], abs=2e-3)
    assert wall.impulse[0] < -1.0
    assert wall.impulse[2] == 0.0


@pytest.mark.parametrize("slip", [0.0, 0.15])
def test_the_hand_turns_with_a_door_but_for_the_slip(slip):
    exercise = load_exercise("door")
    handle, time = exercise.handle, np.linspace(0.0, 3.0, 151)
    mechanism = AnalyticMechanism(exercise.joint, handle)
    share = minimum_jerk(fine_times(time) / 3.0)
    wanted = exercise.joint.carry(handle, exercise.plan.opening * share)[:, :3]
    hands, handles = pull(mechanism, handle, wanted, HABITS, slip)
    assert mechanism.position == pytest.approx(exercise.plan.opening, abs=0.02)
    assert distance(hands[-1], hands[0])[1] == pytest.approx((1 - slip) * mechanism.position)
    assert distance(hands, handles)[0].max() < 0.005


def test_a_hand_that_misjudges_the_hinge_is_kept_on_its_circle():
    exercise = load_exercise("door")
    handle, time = exercise.handle, np.linspace(0.0, 3.0, 151)
    origin = (exercise.joint.origin[0] + 0.02, exercise.joint.origin[1], exercise.joint.origin[2])
    share = minimum_jerk(fine_times(time) / 3.0)
    wanted = replace(exercise.joint, origin=origin).carry(handle, exercise.plan.opening * share)[
        :, :3
    ]
    hands, handles = pull(
        AnalyticMechanism(exercise.joint, handle), handle, wanted, HABITS, slip=0.0
    )
    radius = np.linalg.norm(hands[:, :2] - np.array(exercise.joint.origin)[:2], axis=1)
    assert np.abs(radius - radius[0]).max() < 0.008
    assert np.abs(relative(hands, handles)[:, :3]).max() < 0.01
