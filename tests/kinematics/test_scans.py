import numpy as np
from scipy.spatial.transform import Rotation

from kinfeas.core.solids import Solids
from kinfeas.core.spatial import yaw
from kinfeas.kinematics.scans import scan
from tests.builders import at
from tests.kinematics.conftest import draw_bases, draw_solids

BANDS = ((0.0, 0.35), (0.35, 1.5))


def inside(points, solids, row, low, high):
    """Return which world points (m, 2) are within solids whose heights overlap the band."""
    found = np.zeros(len(points), dtype=np.bool_)
    for (x, y, turn), size, cylinder in zip(
        solids.pose[row], solids.size[row], solids.cylinder[row], strict=True
    ):
        if size[0] > 0.0 and size[2] < high and size[3] > low:
            own = (points - [x, y]) @ Rotation.from_euler("z", turn).as_matrix()[:2, :2]
            within = np.hypot(*own.T) < size[0]
            found |= within if cylinder else np.all(np.abs(own) < size[:2], axis=1)
    return found


def test_beams_end_at_the_first_solid():
    n, beams, longest = 40, 48, 3.0
    solids, bases = draw_solids(n, 8), draw_bases(n)
    ranges = scan(solids, bases, BANDS, beams, longest)
    assert ranges.shape == (n, 2, beams)
    steps = np.linspace(0.0, longest, 1501)
    for row, pose in enumerate(bases):
        angles = yaw(pose) - np.pi + 2.0 * np.pi * np.arange(beams) / beams
        ways = steps[:, np.newaxis] * np.stack([np.cos(angles), np.sin(angles)])[:, np.newaxis]
        points = (pose[:2, np.newaxis, np.newaxis] + ways).reshape(2, -1).T
        for band, (low, high) in enumerate(BANDS):
            hit = inside(points, solids, row, low, high).reshape(len(steps), beams)
            sampled = np.where(hit.any(axis=0), steps[hit.argmax(axis=0)], longest)
            exact = ranges[row, band]
            assert np.all(sampled >= exact - 1e-9)
            # A sample may step over a corner: the middle of the way to it is inside, then.
            entry = pose[:2] + (exact + 1e-6)[:, np.newaxis] * np.stack(
                [np.cos(angles), np.sin(angles)], axis=1
            )
            assert np.all(inside(entry, solids, row, low, high) | (exact == longest))
    assert np.any(ranges == 0.0)
    assert 0.1 < np.mean(ranges == longest) < 0.9


def test_beam_zero_points_backwards_and_bands_are_open_at_touching_solids():
    solids = Solids.empty(1, 2)
    solids.pose[0, :, :2] = [[-1.0, 0.0], [0.0, 1.0]]
    solids.size[0] = [[0.2, 0.3, 0.0, 0.35], [0.2, 0.3, 0.35, 2.0]]
    ranges = scan(solids, at(), BANDS, 4, 5.0)
    np.testing.assert_allclose(ranges[0], [[0.8, 5.0, 5.0, 5.0], [5.0, 5.0, 5.0, 0.7]])
