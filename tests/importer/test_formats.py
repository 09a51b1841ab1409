from pathlib import Path

import numpy as np
import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.importer.arm import find_arm
from kinfeas.importer.boxed import boxed_urdf
from kinfeas.importer.description import read_description
from kinfeas.robots.elements import parse_xml
from kinfeas.robots.urdf_file import urdf_of
from tests.builders import assert_near

MJCF = """<mujoco model="cart">
  <compiler angle="radian"/>
  <asset><mesh name="wedge" vertex="0 0 0  0.2 0 0  0 0.1 0  0 0 0.3"/></asset>
  <worldbody>
    <geom type="plane" size="1 1 0.1"/>
    <body name="cart" pos="0 0 0.1">
      <joint name="x" type="slide" axis="1 0 0"/><joint name="y" type="slide" axis="0 1 0"/>
      <joint name="yaw" axis="0 0 1"/>
      <geom type="box" size="0.2 0.15 0.1"/>
      <body name="lower" pos="0.1 0 0.3" euler="0.3 0.2 0.1">
        <joint name="pan" axis="0 0 1" pos="0 0.05 0" ref="0.4" range="-1 2" damping="0.5"/>
        <joint name="tilt" axis="0 1 0" pos="0.02 0 0.1" range="-2 2" actuatorfrcrange="-9 9"/>
        <geom type="mesh" mesh="wedge" pos="0 0.1 0.02" euler="0 0.5 0"/>
        <body name="hand" pos="0.3 0.05 0" quat="0.9 0.1 0 0.2">
          <joint name="flex" axis="1 1 0"/>
          <geom type="capsule" size="0.02 0.05" mass="1"/>
          <geom type="sphere" size="0.5" mass="0" contype="0" conaffinity="0"/>
          <body name="left" pos="0.1 0.02 0"><joint name="l" type="slide" range="0 0.04"/>
            <geom type="ellipsoid" size="0.01 0.02 0.03"/></body>
          <body name="right" pos="0.1 -0.02 0"><joint name="r" type="slide" range="-0.04 0"/>
            <geom type="cylinder" size="0.01 0.03"/></body>
        </body>
      </body>
    </body>
  </worldbody>
  <equality><joint joint1="r" joint2="l" polycoef="0 -1 0 0 0"/></equality>
  <actuator><position joint="flex" forcerange="-3 3" gear="2"/></actuator>
</mujoco>
"""

XACRO = """<robot name="dolly" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:arg name="length" default="1"/>
  <xacro:include filename="$(find dolly_parts)/{name}"/>
  <xacro:tool length="$(arg length)"/>
</robot>
"""
PARTS = """<robot xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:macro name="tool" params="length"><link name="tool">
    <collision><geometry><box size="${length / 2} 1 1"/></geometry></collision>
  </link></xacro:macro>
</robot>
"""


@pytest.fixture
def cart(tmp_path) -> Path:
    path = tmp_path / "cart.xml"
    path.write_text(MJCF)
    return path


def test_an_mjcf_has_the_poses_of_mujoco(cart, tmp_path):
    mujoco = pytest.importorskip("mujoco")
    urdf = urdf_of(read_description(cart, tmp_path))
    model = mujoco.MjModel.from_xml_path(str(cart))
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    for _ in range(5):
        data.qpos = rng.uniform(-1.0, 1.0, model.nq)
        mujoco.mj_forward(model, data)
        moved = data.qpos - model.qpos0
        poses = urdf.link_poses({model.joint(i).name: moved[i] for i in range(model.njnt)})
        for body in ("cart", "lower", "hand", "left", "right"):
            xyzw = np.roll(data.body(body).xquat, -1)
            assert_near(poses[body], np.concatenate([data.body(body).xpos, xyzw]), 1e-9, 1e-6)


def test_an_mjcf_becomes_a_robot_of_primitives(cart, tmp_path):
    pytest.importorskip("mujoco")
    element = read_description(cart, tmp_path)
    urdf = urdf_of(parse_xml(boxed_urdf(cart, robot=element), "robot", "cart"))
    assert urdf.root == "cart"
    arm = find_arm(urdf, None, "cart")
    assert [joint.name for joint in arm.joints] == ["pan", "tilt", "flex"]
    pan, tilt, flex = arm.joints
    assert (pan.lower, pan.upper, pan.damping) == pytest.approx((-1.4, 1.6, 0.5))
    assert (tilt.effort, flex.effort, flex.kind) == (9.0, 6.0, "continuous")
    assert urdf.followed(urdf.joints["r"])[1:] == (-1.0, 0.0)
    kinds = {name: [shape.kind for shape in link.shapes] for name, link in urdf.links.items()}
    assert kinds["hand"] == ["cylinder", "sphere", "sphere"]
    assert (kinds["left"], kinds["right"]) == (["box"], ["cylinder"])
    wedge = max(shape.reach(np.array([0.0, 1.0, 0.0])) for shape in urdf.links["lower"].shapes)
    assert wedge == pytest.approx(0.2, abs=0.01)
    assert urdf.links["hand"].mass == pytest.approx(1.0)


def test_a_xacro_is_expanded_with_its_arguments_and_packages(tmp_path):
    pytest.importorskip("xacro")
    parts = tmp_path / "clone"
    parts.mkdir()
    (parts / "package.xml").write_text("<package><name>dolly_parts</name></package>")
    (parts / "tool.xacro").write_text(PARTS)
    path = parts / "dolly.urdf.xacro"
    path.write_text(XACRO.format(name="tool.xacro"))
    for arguments, length in (({}, 0.5), ({"length": "3"}, 1.5)):
        urdf = urdf_of(read_description(path, tmp_path, arguments=arguments))
        assert urdf.links["tool"].shapes[0].size[0] == length
    path.write_text('<robot name="dolly"><link name="tool_${1 + 1}"/></robot>')
    assert "tool_2" in urdf_of(read_description(path, tmp_path)).links
    path.write_text(XACRO.format(name="missing.xacro"))
    with pytest.raises(KinfeasError, match=r"dolly\.urdf\.xacro.*missing"):
        read_description(path, tmp_path)


@pytest.mark.parametrize(("content", "arguments", "message"), [
    ('<mujoco><worldbody><geom type="cone"/></worldbody></mujoco>', {}, "cone"),
    ("<mujoco/>", {"length": "1"}, "length"),
    ('<mujoco><worldbody><body><joint type="ball"/><geom size="1"/></body></worldbody></mujoco>',
     {}, "ball"),
    ("<sdf/>", {}, "sdf"),
])  # fmt: skip
def test_descriptions_that_cannot_be_read_are_errors(tmp_path, content, arguments, message):
    pytest.importorskip("mujoco")
    path = tmp_path / "robot.xml"
    path.write_text(content)
    with pytest.raises(KinfeasError, match=rf"robot\.xml.*{message}"):
        read_description(path, tmp_path, arguments=arguments)
