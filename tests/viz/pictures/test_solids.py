import numpy as np
import pytest

from kinfeas.core.spatial import IDENTITY, compose, planar_pose
from kinfeas.kinematics.forward import forward
from kinfeas.robots.urdf import Shape
from kinfeas.viz.pictures.solids import robot_faces


def faces_of(robot, base_pose, name="home"):
    return robot_faces(robot, base_pose, robot.home[name])


def outline(faces):
    return np.concatenate([face.corners for face in faces])


def test_a_robot_has_an_arm_and_a_body_above_the_floor(robot):
    faces = faces_of(robot, IDENTITY)
    assert {face.arm for face in faces} == {True, False}
    low, high = outline(faces).min(axis=0), outline(faces).max(axis=0)
    assert low[2] > -0.05
    assert 0.5 < high[2] < 2.2


def test_only_the_arm_moves(robot, solver):
    other = robot.home["home"].copy()
    other[-1] += 0.3
    moved = [
        not np.allclose(before.corners, after.corners)
        for before, after in zip(
            faces_of(robot, IDENTITY), robot_faces(robot, IDENTITY, other), strict=True
        )
    ]
    arm = [face.arm for face in faces_of(robot, IDENTITY)]
    assert any(moved)
    assert all(part_of_arm for part_of_arm, moves in zip(arm, moved, strict=True) if moves)


def test_the_gripper_is_where_the_ee_is(robot, solver):
    ee = forward(solver.chain, robot.home["home"])
    arm = outline([face for face in faces_of(robot, IDENTITY) if face.arm])
    assert np.min(np.linalg.norm(arm - ee[:3], axis=1)) < 0.2


def test_the_base_carries_everything(robot):
    base = planar_pose(np.array(1.0), np.array(-2.0), np.array(0.7))
    at_origin, moved = outline(faces_of(robot, IDENTITY)), outline(faces_of(robot, base))
    points = np.concatenate([at_origin, np.tile(IDENTITY[3:], (len(at_origin), 1))], axis=1)
    expected = compose(np.broadcast_to(base, points.shape), points)[:, :3]
    np.testing.assert_allclose(moved, expected, atol=1e-12)


@pytest.mark.parametrize(
    "shape",
    [
        Shape("box", (0.3, 0.2, 0.1), IDENTITY),
        Shape("cylinder", (0.2, 0.4), IDENTITY),
        Shape("sphere", (0.2,), IDENTITY),
    ],
)
def test_faces_look_outward(shape):
    from kinfeas.viz.pictures.solids import polygons

    for corners in polygons(shape):
        # Of the polygon's area, since corners of a sphere's cap meet at the pole.
        normal = np.cross(corners, np.roll(corners, -1, axis=0)).sum(axis=0)
        assert normal @ corners.mean(axis=0) >= 0.0
        assert np.all(np.abs(corners) <= 0.4)
