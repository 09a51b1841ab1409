from types import SimpleNamespace

import numpy as np
import pytest

from kinfeas.core import spatial
from kinfeas.sim2real.ros.tf import TfTree, planar


def message(*edges):
    """Return a TFMessage of (parent, child, pose, stamp)."""
    transforms = []
    for parent, child, pose, stamp in edges:
        x, y, z, qx, qy, qz, qw = pose
        header = SimpleNamespace(frame_id=parent, stamp=SimpleNamespace(to_sec=lambda s=stamp: s))
        transform = SimpleNamespace(
            translation=SimpleNamespace(x=x, y=y, z=z),
            rotation=SimpleNamespace(x=qx, y=qy, z=qz, w=qw),
        )
        transforms.append(SimpleNamespace(header=header, child_frame_id=child, transform=transform))
    return SimpleNamespace(transforms=transforms)


def pose(x, y, yaw):
    return spatial.planar_pose(*np.array([x, y, yaw]))


def test_follows_the_frames_to_the_world():
    tree = TfTree("map", "/base_footprint")
    map_odom, odom_base = pose(1.0, -2.0, 2.0), pose(0.5, 0.25, 1.5)
    tree.take(message(("/odom", "base_footprint", odom_base, 7.0)))
    assert tree.reading() is None
    tree.take(
        message(("map", "odom", map_odom, 5.0), ("base_footprint", "base_link", pose(0, 0, 0), 7.0))
    )
    reading = tree.reading()
    expected = spatial.compose(map_odom, odom_base)
    np.testing.assert_allclose([reading.x, reading.y], expected[:2])
    assert reading.yaw == pytest.approx(float(spatial.yaw(expected)))
    assert reading.stamp == 7.0
    assert reading.velocity is None


def test_is_as_old_as_the_oldest_transform_on_the_way(monkeypatch):
    now = [100.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    tree = TfTree("map", "base")
    tree.take(message(("map", "odom", pose(0, 0, 0), 1.0)))
    now[0] = 103.0
    tree.take(message(("odom", "base", pose(0, 0, 0), 4.0)))
    assert tree.reading().age == pytest.approx(3.0)
    tree.take(message(("map", "odom", pose(0, 0, 0), 4.0)))
    assert tree.reading().age == 0.0


def test_what_is_sent_again_grows_old(monkeypatch):
    now = [100.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    tree = TfTree("map", "base")
    for _ in range(4):
        tree.take(message(("map", "base", pose(0, 0, 0), 7.0)))
        now[0] += 0.5
    assert tree.reading().age == pytest.approx(2.0)
    tree.take(message(("map", "base", pose(0, 0, 0), 9.0)))
    assert tree.reading().age == 0.0


def test_a_queue_that_falls_behind_shows_as_age(monkeypatch):
    now = [100.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    tree = TfTree("map", "base")
    tree.take(message(("odom", "base", pose(0, 0, 0), 0.0)))
    for number in range(1, 11):  # sent at 10 Hz, taken out at 5 Hz
        now[0] = 100.0 + 0.2 * number
        tree.take(message(("map", "odom", pose(0, 0, 0), 0.1 * number)))
        tree.take(message(("odom", "base", pose(0, 0, 0), 0.0)))
    assert tree.reading().age == pytest.approx(0.9, rel=0.01)


def test_static_transforms_do_not_age(monkeypatch):
    now = [0.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    tree = TfTree("map", "base")
    tree.take(message(("map", "odom", pose(0, 0, 0), 0.0)), static=True)
    now[0] = 50.0
    tree.take(message(("odom", "base", pose(0, 0, 0), 0.0)))
    assert tree.reading().age == 0.0
    assert tree.reading().stamp is None


def test_a_circle_leads_nowhere():
    tree = TfTree("map", "base")
    tree.take(message(("odom", "base", pose(0, 0, 0), 1.0), ("base", "odom", pose(0, 0, 0), 1.0)))
    assert tree.reading() is None


def test_tilt_and_height_are_left_out():
    turned = spatial.rotation(pose(0, 0, 0.7)) * spatial.rotation(
        np.array([0, 0, 0, np.sin(0.01), 0, 0, np.cos(0.01)])
    )
    x, y, yaw = planar(spatial.make_pose(np.array([1.0, 2.0, 0.3]), turned))
    assert (x, y) == (1.0, 2.0)
    assert yaw == pytest.approx(0.7)


@pytest.mark.parametrize("quaternion", [(0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.5), (np.nan,) * 4])
def test_a_broken_quaternion_makes_no_pose(quaternion):
    assert np.isnan(planar(np.array([1.0, 2.0, 0.0, *quaternion]))).all()
