"""Worlds of both physics engines, and a scene for them."""

import struct
from pathlib import Path

import numpy as np
import pytest
import yaml

from kinfeas.config import registry
from kinfeas.robots.loading import load_robot
from kinfeas.scenes.scene import read_scene
from tests.builders import at, twist

EXAMPLE = Path(__file__).parents[2] / "examples" / "own_robot"
INERTIA = (
    "<inertial>{}<mass value='{}'/>"
    "<inertia ixx='{i}' iyy='{i}' izz='{i}' ixy='0' ixz='0' iyz='0'/></inertial>"
)
BOX = "<collision>{}<geometry><box size='{}'/></geometry></collision>"
URDFS = {
    "bar": f"""<robot name="bar"><link name="bar">{INERTIA.format("", 0.3, i=3e-4)}
  {BOX.format("", "0.04 0.04 0.1")}</link></robot>""",
    "wall": f"""<robot name="wall"><link name="wall">
  {INERTIA.format("<origin xyz='0.1 0.2 0.5'/>", 10, i=1)}
  {BOX.format("<origin xyz='0 0 0.5'/>", "0.1 6 1")}</link></robot>""",
    "chest": f"""<robot name="chest"><link name="chest">{INERTIA.format("", 10, i=1)}
  {BOX.format("", "0.5 0.5 0.5")}</link>
  <link name="drawer">{INERTIA.format("", 2, i=1)}</link>
  <joint name="slide" type="prismatic"><parent link="chest"/><child link="drawer"/>
    <axis xyz="1 0 0"/><limit lower="-0.4" upper="0.4" velocity="1" effort="50"/>
    <dynamics damping="1" friction="3"/></joint></robot>""",
}
SCENE = """
name: small
size: [10, 10]
objects:
  bar: {urdf: bar.urdf, position: [3, 3, 0.05], fixed: false}
  post: {urdf: bar.urdf, position: [4, 4, 0.05]}
  wall: {urdf: wall.urdf, position: [-3, 0, 0]}
  chest: {urdf: chest.urdf, position: [0, -4, 0.5]}
"""

CORNERS = ((0, 0, 0), (0.1, 0, 0), (0, 0.1, 0), (0, 0, 0.1))
STL = bytes(80) + struct.pack("<I", 4) + b"".join(
    struct.pack("<12fH", 0, 0, 1, *(x for i in range(4) if i != left for x in CORNERS[i]), 0)
    for left in range(4)
)  # fmt: skip


@pytest.fixture(scope="session", params=["pybullet", "mujoco"])
def engine(request):
    """Class of the backend; modules of one engine replace it."""
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

    def build(robot, scene=None, **options):
        worlds.append(engine(robot, scene, **options))
        return worlds[-1]

    yield build
    for world in worlds:
        world.close()


@pytest.fixture
def scout(tmp_path):
    """A function that reads the example robot with changes of its URDF and its settings.

    Its URDF lies in `rover/urdf`.
    """
    folder = tmp_path / "rover" / "urdf"

    def read(change=lambda urdf: urdf, **settings):
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "robot.urdf").write_text(change((EXAMPLE / "robot.urdf").read_text()))
        spec = yaml.safe_load((EXAMPLE / "robot.yaml").read_text())
        for key, values in settings.items():
            spec[key] |= values
        (folder / "robot.yaml").write_text(yaml.safe_dump(spec, sort_keys=False))
        return load_robot(folder)

    return read


def place(world, x=0.0, y=0.0, yaw=0.0, joints=None, scene=None):
    """Reset a world to the home configuration, at the origin by default."""
    joints = world.robot.home["home"] if joints is None else joints
    base = at(x, y, yaw)
    if scene is not None:
        world.place(0, scene, base[0], joints)
    return world.reset(base, joints[np.newaxis])


def stay(world, ticks, base_twist=None, dt=0.02):
    """Hold the arm at home for some control periods; return the states."""
    home = world.robot.home["home"][np.newaxis]
    command = twist() if base_twist is None else base_twist
    return [world.step(command, home, dt) for _ in range(ticks)]
