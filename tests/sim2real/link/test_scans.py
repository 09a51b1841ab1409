from dataclasses import replace

import numpy as np
import pytest

from kinfeas.core.backend import SCAN_BANDS, SCAN_BEAMS, SCAN_RANGE
from kinfeas.core.solids import Solids
from kinfeas.core.spatial import compose, planar_pose
from kinfeas.kinematics.sensing import scan
from kinfeas.sim2real.link.scans import (
    ANGLES,
    CostmapReading,
    LaserReading,
    combined,
    costmap_ranges,
    laser_ranges,
)

RAYS, CELL = 24 * SCAN_BEAMS, 0.05
MARGIN = 0.02  # more than the distance of rays at the longest range
SECTOR = 2.0 * np.pi / SCAN_BEAMS


def draw(seed, places=8):
    """Return solids and the base pose among them, as (x, y, yaw) too."""
    rng, solids = np.random.default_rng(seed), Solids.empty(1, places)
    base = (*rng.uniform(-3.0, 3.0, 2), rng.uniform(-np.pi, np.pi))
    distance, angle = rng.uniform(1.0, 4.0, places), rng.uniform(-np.pi, np.pi, places)
    solids.pose[0, :, 0] = base[0] + distance * np.cos(angle)
    solids.pose[0, :, 1] = base[1] + distance * np.sin(angle)
    solids.pose[0, :, 2] = rng.uniform(-np.pi, np.pi, places)
    solids.cylinder[0] = rng.random(places) < 0.5
    solids.size[0, :, :2] = rng.uniform(0.1, 0.5, (places, 2))
    solids.size[0, :, 1] = np.where(solids.cylinder[0], *solids.size[0, :, :2].T)
    solids.size[0, :, 3] = 1.0
    return solids, planar_pose(*np.array([[value] for value in base])), base


def grown(solids, by):
    size = solids.size.copy()
    size[..., :2] = np.maximum(size[..., :2] + by, 0.0)
    return replace(solids, size=size)


def scanned(solids, pose, beams=SCAN_BEAMS, longest=SCAN_RANGE):
    return scan(solids, pose, SCAN_BANDS[:1], beams, longest)[0, 0]


def laser(solids, pose, mount):
    ranges = scanned(solids, compose(pose, planar_pose(*np.array(mount)[:, np.newaxis])), RAYS, 8.0)
    ranges = np.where(ranges < 8.0, ranges, np.inf)
    return LaserReading(ranges, -np.pi, 2.0 * np.pi / RAYS, 0.02, 8.0, mount)


def sector_minima(solids, pose):
    fine = scanned(solids, pose, RAYS)
    each = RAYS // SCAN_BEAMS
    return np.roll(fine, each // 2).reshape(SCAN_BEAMS, each).min(axis=1)


def nearest_around(solids, pose):
    """Return the same of each sector and those beside it, less the spacing of rays."""
    minima = sector_minima(grown(solids, MARGIN), pose)
    return np.min([np.roll(minima, shift) for shift in (-1, 0, 1)], axis=0)


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("aside", [0.0, 0.3])
def test_a_laser_measures_the_nearest_point_of_each_sector(seed, aside):
    solids, pose, _ = draw(seed)
    mount = np.random.default_rng(seed).uniform([-aside, -aside, -np.pi], [aside, aside, np.pi])
    ranges, expected = laser_ranges(laser(solids, pose, mount)), scanned(solids, pose)
    assert np.all(ranges >= nearest_around(solids, pose))
    # Beams that end at the solid nearest to the laser have no other one before them.
    assert ranges[np.argmin(expected)] <= expected.min() + 0.1
    if not aside:
        assert np.all(ranges <= scanned(grown(solids, -MARGIN), pose) + MARGIN)
        assert np.mean(np.abs(ranges - sector_minima(solids, pose)) < MARGIN) > 0.9


def test_readings_without_return_and_sectors_without_rays():
    ranges = np.array([np.nan, np.inf, 9.0, 0.01, 1.0, -np.inf, np.inf, np.inf])
    angles = {"angle_min": -4 * SECTOR, "angle_increment": SECTOR}
    limits = {"range_min": 0.1, "range_max": 8.0}
    nearest = laser_ranges(LaserReading(ranges, **angles, **limits))
    middle = SCAN_BEAMS // 2
    np.testing.assert_allclose(
        nearest[middle - 3 : middle + 4], [*[SCAN_RANGE] * 3, 1.0, 0.1, SCAN_RANGE, SCAN_RANGE]
    )
    assert np.isnan(np.delete(nearest, range(middle - 3, middle + 4))).all()
    half = np.where(np.arange(360) < 180, np.nan, 2.0)  # of rays that are denser than the beams
    right = laser_ranges(LaserReading(half, -np.pi, np.pi / 180.0))
    assert np.isnan(right[1 : middle - 1]).all()
    np.testing.assert_allclose(right[middle:], 2.0)
    for dead in (np.nan, 0.0):
        assert np.isnan(laser_ranges(LaserReading(np.full(8, dead), **angles, **limits))).all()
    for wrong in ({"range_max": np.nan}, {"range_max": 0.0}, {"angle_increment": np.nan}):
        reading = LaserReading(np.full(8, 0.5), **{**angles, **wrong})
        assert np.isnan(laser_ranges(reading)).all()
    assert not np.isnan(laser_ranges(LaserReading(np.full(8, np.inf), **angles))[middle])


@pytest.mark.parametrize("seed", range(8))
def test_a_costmap_has_the_ranges_of_its_solids_to_within_a_cell(seed):
    solids, pose, base = draw(seed)
    rng = np.random.default_rng(seed)
    turn, edge = rng.uniform(-np.pi, np.pi), 8.0
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    origin = np.array(base[:2]) + rotation @ (-0.5 * edge + rng.uniform(-0.5, 0.5, 2))
    cells = np.stack(np.meshgrid(*[(np.arange(round(edge / CELL)) + 0.5) * CELL] * 2), -1)
    points = np.full((*cells.shape[:2], 3), 0.1)
    points[..., :2] = origin + cells @ rotation.T
    occupied = solids.gaps(points.reshape(1, -1, 3))[0].min(axis=2).reshape(cells.shape[:2]) <= 0.0
    values = np.where(occupied, 100, 0).astype(np.int8)
    costmap = CostmapReading(values, CELL, (*origin.tolist(), turn))
    ranges = costmap_ranges(costmap, base)
    corner_gap, step = CELL / np.sqrt(2.0), CELL / 2.0
    assert np.all(ranges >= scanned(grown(solids, corner_gap), pose) - 1e-9)
    longest = scanned(grown(solids, -corner_gap - step), pose) + step
    assert np.all(ranges <= np.minimum(longest, SCAN_RANGE) + 1e-9)


def test_a_costmap_is_blind_where_it_is_unknown():
    cells = np.zeros((60, 60), dtype=np.int8)
    cells[:, :28] = -1  # behind the robot
    cells[29:31, 45:] = 99
    costmap = CostmapReading(cells, CELL, (-1.5, -1.5, 0.0), occupied=65)
    ranges = costmap_ranges(costmap, (0.0, 0.0, 0.0))
    assert np.isnan(ranges[np.abs(ANGLES) > 0.6 * np.pi]).all()
    assert not np.isnan(ranges[np.abs(ANGLES) < 0.4 * np.pi]).any()
    assert ranges[SCAN_BEAMS // 2] == pytest.approx(0.75, abs=CELL)
    assert ranges[SCAN_BEAMS * 3 // 4] == SCAN_RANGE
    certain = replace(costmap, occupied=100)
    assert costmap_ranges(certain, (0.0, 0.0, 0.0))[SCAN_BEAMS // 2] == SCAN_RANGE
    assert np.isnan(costmap_ranges(costmap, (9.0, 9.0, 0.0))).all()


def test_a_band_without_its_sensor_has_the_ranges_of_the_other():
    low, high = np.full(SCAN_BEAMS, 1.0), np.full(SCAN_BEAMS, 2.0)
    low[:3], high[2:4] = np.nan, np.nan
    both = combined(low, high, 0.5)
    np.testing.assert_array_equal(both.ranges[0, 0, :5], [2.0, 2.0, SCAN_RANGE, 1.0, 1.0])
    np.testing.assert_array_equal(both.ranges[0, 1, :5], [2.0, 2.0, SCAN_RANGE, 1.0, 2.0])
    assert np.flatnonzero(both.blind).tolist() == [2]
    np.testing.assert_array_equal(combined(low, None, 0.0).blind, np.isnan(low))
    assert combined(np.full(SCAN_BEAMS, np.nan), high, 0.0).blind.all()
