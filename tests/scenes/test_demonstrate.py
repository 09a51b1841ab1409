import numpy as np
import pytest

from kinfeas.core.spatial import distance, relative, rotation, wrap, yaw
from kinfeas.scenes.demonstrate import demonstrate, load_habits
from kinfeas.scenes.exercise import EXERCISES, load_exercise

HABITS = load_habits()


@pytest.fixture(scope="module", params=EXERCISES)
def name(request):
    return request.param


@pytest.fixture(scope="module")
def takes(name):
    return demonstrate(load_exercise(name), HABITS, 12, seed=0)


def in_handle(shown, pose="ee_pose"):
    return relative(getattr(shown, pose), shown.object_pose)


def test_the_same_seed_gives_the_same_to_the_bit(name, takes):
    again = demonstrate(load_exercise(name), HABITS, 2, seed=0)
    other = demonstrate(load_exercise(name), HABITS, 1, seed=1)
    for first, second in zip(takes, again, strict=False):
        np.testing.assert_array_equal(first.open.ee_pose, second.open.ee_pose)
        np.testing.assert_array_equal(first.grasp.base_pose, second.grasp.base_pose)
    assert not np.array_equal(other[0].grasp.object_pose[0], takes[0].grasp.object_pose[0])


def test_what_is_recorded(takes):
    for take in takes:
        for shown in (take.grasp, take.open):
            duration = shown.time[-1] - shown.time[0]
            assert HABITS.duration[0] <= duration <= HABITS.duration[1]
            np.testing.assert_allclose(np.diff(shown.time), 1.0 / HABITS.sample_rate)
            for pose in (shown.ee_pose, shown.base_pose, shown.object_pose):
                assert pose.shape == (len(shown.time), 7)
                np.testing.assert_allclose(np.linalg.norm(pose[:, 3:], axis=1), 1.0, atol=1e-5)
            assert np.all(shown.object_pose == shown.object_pose[0])
            assert np.all(shown.base_pose[:, [2, 3, 4]] == 0.0)


def test_the_furniture_is_elsewhere_each_time(name, takes):
    places = np.array([take.grasp.object_pose[0] for take in takes])
    assert np.ptp(places[:, 0]) > 1.0
    assert np.all(places[:, 2] == load_exercise(name).handle[2])
    assert np.ptp(yaw(places)) > 3.0


def test_the_pull_begins_where_the_reach_ended(takes):
    for take in takes:
        for pose in ("ee_pose", "base_pose"):
            before, after = getattr(take.grasp, pose)[-1], getattr(take.open, pose)[0]
            assert distance(before, after) == pytest.approx((0.0, 0.0), abs=1e-5)


def test_reaches_start_in_front_and_scatter_at_the_handle(name, takes):
    exercise = load_exercise(name)
    ways = [in_handle(take.grasp) for take in takes]
    starts, ends = (np.array([way[moment, :3] for way in ways]) for moment in (0, -1))
    np.testing.assert_allclose(starts.mean(axis=0), exercise.plan.start, atol=0.015)
    spread = np.sqrt(np.mean(np.sum(ends**2, axis=1)))
    assert HABITS.grasp_scatter / 2.0 < spread < 2.0 * HABITS.grasp_scatter
    turns = [rotation(way[-1]).as_euler("xyz")[0] - exercise.plan.gripper_roll for way in ways]
    assert np.abs(np.mean(turns)) < np.deg2rad(5.0)


def test_the_door_swings_about_its_hinge_into_the_room():
    takes = demonstrate(load_exercise("door"), HABITS, 12, seed=0)
    paths = [in_handle(take.open)[:, :2] for take in takes]
    circles = np.array([circle(path) for path in paths])
    assert circles[:, 2].mean() == pytest.approx(0.312, abs=0.01)
    arcs = [angle_around(path, centre) for path, centre in zip(paths, circles, strict=True)]
    turns = [distance(take.open.ee_pose[-1], take.open.ee_pose[0])[1] for take in takes]
    assert np.rad2deg(np.mean(arcs)) == pytest.approx(96.0, abs=2.0)
    assert np.rad2deg(np.mean(turns)) == pytest.approx(81.0, abs=3.0)
    # Hinged on the right as seen from the room, it comes toward the one who pulls.
    assert np.mean([path[-1, 0] for path in paths]) == pytest.approx(-0.28, abs=0.02)
    assert np.mean([path[-1, 1] for path in paths]) == pytest.approx(-0.38, abs=0.02)


def test_the_drawer_comes_straight_out_and_the_hand_rises():
    ways = [in_handle(take.open) for take in demonstrate(load_exercise("drawer"), HABITS, 12, 0)]
    moved = np.mean([way[-1, :3] - way[0, :3] for way in ways], axis=0)
    np.testing.assert_allclose(moved, [-0.24, 0.0, 0.02], atol=0.01)
    assert max(np.ptp(way[:, 1]) for way in ways) < 0.02


def test_the_base_follows_at_arms_length_and_faces_the_hand(name, takes):
    travels = []
    for take in takes:
        for shown in (take.grasp, take.open):
            toward = (shown.ee_pose - shown.base_pose)[:, :2]
            assert np.abs(np.linalg.norm(toward, axis=1) - HABITS.arm_length).max() < 0.16
            off = wrap(np.arctan2(toward[:, 1], toward[:, 0]) - yaw(shown.base_pose))
            assert np.abs(off).max() < 1e-4
        base = take.open.base_pose
        travels.append(float(distance(base[-1], base[0])[0]))
    assert np.mean(travels) == pytest.approx({"door": 0.44, "drawer": 0.22}[name], abs=0.01)


def circle(points):
    """Return centre and radius of the circle nearest to points (n, 2)."""
    columns = np.column_stack([2.0 * points, np.ones(len(points))])
    x, y, rest = np.linalg.lstsq(columns, np.sum(points**2, axis=1), rcond=None)[0]
    return np.array([x, y, np.sqrt(rest + x**2 + y**2)])


def angle_around(points, centre):
    """Return how far points (n, 2) go around a centre, radians."""
    away = points - centre[:2]
    return abs(np.ptp(np.unwrap(np.arctan2(away[:, 1], away[:, 0]))))
