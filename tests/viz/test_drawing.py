from unittest.mock import Mock

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kinfeas.core.spatial import make_pose, rotation
from kinfeas.robots.urdf import Shape
from kinfeas.scenes.scene import Scene, read_scene
from kinfeas.viz.drawing import Face, back_to_front, scene_figure
from kinfeas.viz.shapes import corners, faces, scene_solids


def test_the_nearest_face_is_drawn_last():
    rng, seen = np.random.default_rng(0), []
    for kind, size in (("box", (1.0, 0.4, 0.1)), ("cylinder", (0.2, 0.9))) * 4:
        pose = make_pose(rng.uniform(-0.5, 0.5, 3), Rotation.random(rng=rng))
        for face in faces(Shape(kind, size, pose)):
            normal = np.cross(face[1] - face[0], face[2] - face[0])
            normal /= np.linalg.norm(normal)
            if normal[2] > 1e-3:  # the viewer is above
                seen.append(Face(face, normal, np.ones(4)))
    drawn = back_to_front(list(seen))
    for point in rng.uniform(-0.7, 0.7, (300, 2)):
        depths = [depth for face in drawn if (depth := height(face, point)) is not None]
        assert not depths or depths[-1] >= max(depths) - 1e-9


def height(face, point):
    """Return how high a face is above a point, None beside it."""
    edges = np.roll(face.corners, -1, axis=0) - face.corners
    away = point - face.corners[:, :2]
    if np.any(edges[:, 0] * away[:, 1] - edges[:, 1] * away[:, 0] < -1e-9):
        return None
    return (face.normal @ face.corners[0] - face.normal[:2] @ point) / face.normal[2]


def test_scenes_of_walls_alone_have_a_picture():
    assert scene_figure(read_scene("doorway")).axes


def test_scenes_without_objects_have_a_picture():
    assert scene_figure(Scene("hall", (4.0, 3.0), {}, {})).axes


def test_furniture_at_a_wall_is_drawn_from_its_open_side():
    scene = read_scene("shelf")
    (axes,) = scene_figure(scene).axes
    heading = np.deg2rad(axes.azim)
    toward_viewer = np.array([np.cos(heading), np.sin(heading)])
    front = rotation(scene.objects["cabinet"].pose).apply([1.0, 0.0, 0.0])[:2]
    assert front @ toward_viewer > 0.7
    pytest.importorskip("viser")
    from kinfeas.viz.pages import aim

    server, cabinet = Mock(), [each for each in scene_solids(scene) if each.link[0] == "cabinet"]
    aim(server, corners(cabinet))
    away = (server.initial_camera.position - server.initial_camera.look_at)[:2]
    assert front @ away > 0.7 * np.linalg.norm(away)
