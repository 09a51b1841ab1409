import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kinfeas.core.spatial import IDENTITY, make_pose
from kinfeas.importer.arm import Placed, link_pose
from kinfeas.kinematics.forward import build_chain, forward
from kinfeas.robots.loading import load_robot
from kinfeas.robots.urdf import Shape

POSE = make_pose(np.array([0.1, -0.2, 0.3]), Rotation.from_euler("xyz", [0.3, 0.5, -0.8]))


def surface(kind, size):
    """Many points on a shape about the origin, shape (n, 3)."""
    rng = np.random.default_rng(0)
    if kind == "box":
        return rng.choice([-0.5, 0.5], (64, 3)) * size
    angle = rng.uniform(0.0, 2.0 * np.pi, 200_000)
    up = rng.uniform(-1.0, 1.0, angle.shape)
    if kind == "sphere":
        flat = np.sqrt(1.0 - up**2)
        return size[0] * np.column_stack([flat * np.cos(angle), flat * np.sin(angle), up])
    ends = np.sign(up) * size[1] / 2.0
    return np.column_stack([size[0] * np.cos(angle), size[0] * np.sin(angle), ends])


@pytest.mark.parametrize(
    ("kind", "size"), [("box", (0.2, 0.3, 0.5)), ("cylinder", (0.2, 0.7)), ("sphere", (0.3,))]
)
@pytest.mark.parametrize("direction", [[1.0, 0.0, 0.0], [0.0, 0.6, -0.8]])
def test_a_shape_goes_as_far_as_its_farthest_point(kind, size, direction):
    points = Rotation.from_quat(POSE[3:]).apply(surface(kind, size)) + POSE[:3]
    reach = Placed(Shape(kind, size, IDENTITY), POSE).reach(np.array(direction))
    assert reach == pytest.approx(np.max(points @ direction), abs=1e-4)


@pytest.mark.parametrize("name", ["pr2", "tiago", "hsr"])
def test_links_are_where_forward_kinematics_has_them(name):
    robot = load_robot(name)
    home = robot.home["home"]
    positions = {joint.name: at for joint, at in zip(robot.arm, home, strict=True)}
    expected = forward(build_chain(robot), home[np.newaxis])[0]
    found = link_pose(robot.urdf, robot.ee_frame, robot.fixed_joints | positions)
    np.testing.assert_allclose(found, expected, atol=1e-9)
