"""Motions learned from a simulated door."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import IDENTITY, compose, distance, make_pose, relative
from kinfeas.io.demonstrations import (
    Demonstration,
)
from kinfeas.plugins.fit import fit
from kinfeas.plugins.imitation import learned_path
from tests.plugins.conftest import ANGLE, KINDS, RADIUS, door_demonstrations, random_poses


def knots(shown, **options):
    return learned_path(fit(shown, **options).model).knots


@pytest.mark.parametrize("kind", KINDS)
def test_learns_the_demonstrated_path_and_the_mean_end(kind):
    found = fit(door_demonstrations(scatter=0.0), kind)
    path = learned_path(found.model).knots
    radius = np.hypot(path[:, 0] + RADIUS, path[:, 1])
    assert np.abs(radius - RADIUS).max() < 0.008
    assert np.abs(path[:, 2]).max() < 1e-6
    assert max(found.position_residual) < 0.004
    assert max(found.rotation_residual) < 0.02
    assert found.length == pytest.approx(RADIUS * ANGLE, rel=1e-3)
    shown = door_demonstrations()
    ends = np.stack([relative(one.ee_pose[-1], one.object_pose[0]) for one in shown])
    mean = make_pose(ends[:, :3].mean(axis=0), Rotation.from_quat(ends[:, 3:]).mean())
    assert max(distance(knots(shown, kind=kind)[-1], mean)) < 1e-7


def _paused(shown):
    """Return the demonstration with a second's rest before, amidst and after it."""
    last = len(shown.time) - 1
    index = np.sort(np.concatenate([np.arange(last + 1), np.repeat([0, last // 2, last], 30)]))
    poses = (shown.ee_pose, shown.base_pose, shown.object_pose)
    return Demonstration(np.arange(len(index)) / 30.0, *(pose[index] for pose in poses))


def test_the_object_s_pose_and_pauses_do_not_matter():
    shown = door_demonstrations(base=False)
    moved = [
        replace(one, ee_pose=compose(pose, one.ee_pose), object_pose=compose(pose, one.object_pose))
        for one, pose in zip(shown, random_poses(len(shown), 0), strict=True)
    ]
    expected = knots(shown)
    assert np.allclose(knots(moved), expected, atol=1e-5)
    assert np.allclose(knots([_paused(one) for one in shown]), expected, atol=1e-5)


def test_learns_the_base_if_all_demonstrations_have_one():
    shown = door_demonstrations(12, scatter=0.0)
    base = learned_path(fit(shown).model).base
    assert np.ptp(base[:, 2]) < 0.6  # headings a turn apart are the same
    assert not fit([*shown, *door_demonstrations(1, base=False)]).model.has_base


def test_other_wrong_input_raises():
    angle = np.linspace(0.0, 7.0, 100)[:, np.newaxis]
    ee = make_pose(np.zeros((100, 3)), Rotation.from_rotvec(angle * [0.0, 0.0, 1.0]))
    still = np.tile(IDENTITY, (100, 1))
    with pytest.raises(KinfeasError, match="3 rad"):
        fit([Demonstration(np.linspace(0.0, 5.0, 100), ee, still, still)])
    with pytest.raises(KinfeasError, match="demonstration"):
        fit([])
