import numpy as np
import pytest

from kinfeas.control.execution import tool_pose
from kinfeas.core import registry, spatial
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolver
from kinfeas.scenes.scene import read_scene
from tests.builders import at, twist

INERTIA = "<mass value='{}'/><inertia ixx='{}' iyy='{}' izz='{}' ixy='0' ixz='0' iyz='0'/>"
URDFS = {
    "bar": f"""
<robot name="bar"><link name="bar"><inertial>{INERTIA.format(0.3, 3e-4, 3e-4, 3e-4)}</inertial>
  <collision><geometry><box size="0.04 0.04 0.1"/></geometry></collision></link></robot>""",
    "wall": f"""
<robot name="wall"><link name="wall">
  <inertial><origin xyz="0.1 0.2 0.5"/>{INERTIA.format(10, 1, 1, 1)}</inertial>
  <collision><origin xyz="0 0 0.5"/><geometry><box size="0.1 6 1"/></geometry></collision>
  </link></robot>""",
    "chest": f"""
<robot name="chest"><link name="chest"><inertial>{INERTIA.format(10, 1, 1, 1)}</inertial>
    <collision><geometry><box size="0.5 0.5 0.5"/></geometry></collision></link>
  <link name="drawer"><inertial>{INERTIA.format(2, 1, 1, 1)}</inertial></link>
  <joint name="slide" type="prismatic"><parent link="chest"/><child link="drawer"/>
    <axis xyz="1 0 0"/><limit lower="-0.4" upper="0.4" velocity="1" effort="50"/>
    <dynamics damping="1" friction="3"/></joint></robot>""",
}
SCENE = """
name: small
size: [10, 10]
objects:
  bar: {urdf: bar.urdf, position: [3, 3, 0.05], fixed: false}
  wall: {urdf: wall.urdf, position: [-3, 0, 0]}
  chest: {urdf: chest.urdf, position: [0, -4, 0.5]}
"""


@pytest.fixture(scope="session", params=["pybullet", "mujoco"])
def engine(request):
    pytest.importorskip(request.param)
    return registry.load("kinfeas.backends", request.param)


@pytest.fixture(scope="session")
def scene_path(tmp_path_factory):
    """A scene with a bar to grasp, a wall to run into and a drawer to pull."""
    folder = tmp_path_factory.mktemp("scene")
    for name, text in URDFS.items():
        (folder / f"{name}.urdf").write_text(text)
    (folder / "small.yaml").write_text(SCENE)
    return str(folder / "small.yaml")


@pytest.fixture(scope="session")
def scene(scene_path):
    return read_scene(scene_path)


@pytest.fixture(scope="session")
def world(hsr, scene, engine):
    """An HSR in that scene; every test starts with a reset."""
    backend = engine(hsr, scene)
    yield backend
    backend.close()


@pytest.fixture
def begin(world, scene):
    """A function that resets the world to the home configuration, at the origin by default."""

    def reset(x=0.0, y=0.0, yaw=0.0, joints=None, **poses):
        return place(world, x, y, yaw, joints, scene.with_poses(poses))

    return reset


@pytest.fixture
def opened(engine):
    """A function that builds a world, which is closed after the test."""
    worlds = []

    def build(robot, scene=None):
        worlds.append(engine(robot, scene))
        return worlds[-1]

    yield build
    for world in worlds:
        world.close()


@pytest.fixture(scope="session")
def between_fingers(hsr):
    """World pose of the tool tip at home, x along the approach."""
    ee = forward(IkSolver(hsr).chain, hsr.home["home"])
    return spatial.compose(ee, tool_pose(hsr))


def place(world, x=0.0, y=0.0, yaw=0.0, joints=None, scene=None):
    """Reset a world to the home configuration, at the origin by default."""
    joints = world.robot.home["home"] if joints is None else joints
    base = at(x, y, yaw)
    if scene is not None:
        world.place(0, scene, base[0], joints)
    return world.reset(base, joints[np.newaxis])


def stay(world, ticks, base_twist=None, dt=0.02):
    home = world.robot.home["home"][np.newaxis]
    command = twist() if base_twist is None else base_twist
    return [world.step(command, home, dt) for _ in range(ticks)]
