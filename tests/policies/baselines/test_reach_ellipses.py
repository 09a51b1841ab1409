from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import make_pose, planar_pose, relative
from kinfeas.policies.baselines.reach_ellipses import ReachEllipses, approach, fit_ellipses
from kinfeas.robots.loading import load_robot


def test_the_fit_is_the_same_each_time(robot, ellipses):
    if robot.name == "hsr":  # it takes two seconds
        again = fit_ellipses(robot)
        np.testing.assert_array_equal(again.shapes, ellipses.shapes)
        assert again.bearing == ellipses.bearing


def test_shapes_are_sound(ellipses):
    centre, outer, inner = np.split(ellipses.shapes, 3, axis=-1)
    assert np.isfinite(ellipses.shapes).all()
    assert outer.min() > 0.05
    assert outer.max() < 1.5
    assert inner.min() >= 0.1 - 1e-12
    assert np.abs(centre).max() < 1.0
    assert ellipses.heights.shape + ellipses.pitches.shape + (6,) == ellipses.shapes.shape


def test_ik_reaches_far_more_within_than_beyond(robot, solver, ellipses):
    rng = np.random.default_rng(5)
    n = 6000
    low, high = robot.goal_heights["ggr"]
    position = np.stack([np.zeros(n), np.zeros(n), rng.uniform(low, high, n)], axis=1)
    ee = make_pose(position, Rotation.from_euler("xyz", rng.uniform(0.0, 2.0 * np.pi, (n, 3))))
    x, y = rng.uniform(-1.0, 1.0, (2, n))
    # The base faces the EE at its preferred bearing.
    base = planar_pose(x, y, np.arctan2(-y, -x) - ellipses.bearing)
    home = np.tile(robot.home["home"], (n, 1))
    found = solver.solve(relative(ee, base), home).feasible
    pitch, azimuth = approach(robot, ee)
    shape = ellipses.at(ee[:, 2], pitch)
    seen_x = np.cos(azimuth) * x + np.sin(azimuth) * y
    seen_y = np.cos(azimuth) * y - np.sin(azimuth) * x
    outer = np.hypot((seen_x - shape[:, 0]) / shape[:, 2], (seen_y - shape[:, 1]) / shape[:, 3])
    inner = np.hypot(seen_x / shape[:, 4], seen_y / shape[:, 5])
    within = (outer < 1.0) & (inner > 1.0)
    assert found[within].mean() > 2.5 * found[~within].mean()


@pytest.mark.parametrize(
    ("heights", "words"),
    [
        ({"ggr": (5.0, 6.0)}, "robot 'hsr' reaches its goal_heights of ggr, 5 to 6 m"),
        ({"shelf": (0.2, 1.2)}, "needs goal_heights of ggr, and robot 'hsr' has none"),
    ],
)
def test_a_robot_that_reaches_nothing_is_refused(heights, words):
    robot = replace(load_robot("hsr"), goal_heights=heights)
    with pytest.raises(KinfeasError, match=words):
        fit_ellipses(robot)


def test_the_ee_is_before_the_arm_at_the_preferred_bearing(robot, ellipses):
    expected = {"pr2": (-1.2, -0.1), "tiago": (-0.4, 0.4), "hsr": (-0.4, 0.5)}[robot.name]
    assert expected[0] < ellipses.bearing < expected[1]


def test_between_the_grid_and_beyond_it():
    heights, pitches = np.array([0.0, 1.0]), np.array([-1.0, 0.0, 1.0])
    shapes = np.zeros((2, 3, 6))
    shapes[..., 0] = heights[:, None] + 10.0 * pitches
    ellipses = ReachEllipses(heights, pitches, shapes, 0.0)
    found = ellipses.at(np.array([0.25, 5.0, -1.0]), np.array([0.5, -0.5, 9.0]))
    np.testing.assert_allclose(found[:, 0], [5.25, -4.0, 10.0])


@pytest.mark.parametrize("pitch", [-1.2, 0.0, 0.8])
def test_approach_in_the_gripper_convention(robot, pitch):
    gripper = Rotation.from_euler("ZYX", [[0.7, -pitch, roll] for roll in (0.0, 2.0, -1.0)])
    turn = gripper * Rotation.from_quat(robot.gripper_rotation)
    found = approach(robot, make_pose(np.zeros((3, 3)), turn))
    np.testing.assert_allclose(found, [[pitch] * 3, [0.7] * 3], atol=1e-12)
