import math
from pathlib import Path

import numpy as np
import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.importer.arm import find_arm
from kinfeas.importer.boxed import boxed_urdf
from kinfeas.importer.description import doubts, find_drive, read_description
from kinfeas.importer.draft import draft_robot
from kinfeas.robots.urdf_file import parse_urdf, urdf_of
from tests.builders import assert_near


def moving(name, parent="base", axis="0 1 0"):
    return (
        f'<link name="{name}"/><joint name="{name}_joint" type="continuous">'
        f'<parent link="{parent}"/><child link="{name}"/><axis xyz="{axis}"/></joint>'
    )


def wheels(*names, **options):
    return "".join(moving(name, **options) for name in names)


SWERVE = "".join(
    moving(f"fork_{i}", axis="0 0 1") + moving(f"wheel_{i}", f"fork_{i}") for i in range(3)
)
CASTER = moving("caster", axis="0 0 1") + moving("caster_wheel", "caster")
SPRINGS = "".join(
    moving(f"spring_{i}", axis="0 0 1").replace("continuous", "revolute").replace(
        "</joint>", '<limit lower="0" upper="0.01" velocity="1"/></joint>'
    ).replace("revolute", "prismatic")
    + moving(f"wheel_{i}", f"spring_{i}")
    for i in range(2)
)  # fmt: skip


@pytest.mark.parametrize(("text", "drive", "named"), [
    ("", "differential", "guess"),
    (wheels("wheel_l", "wheel_r"), "differential", "wheel_l_joint, wheel_r_joint"),
    (wheels("drive_l", "drive_r") + CASTER, "differential", "drive_l_joint, drive_r_joint"),
    (SPRINGS, "differential", "wheel_0_joint, wheel_1_joint"),
    (wheels("a", "b", "c", "d"), "differential", "guess"),
    (wheels("mecanum_a", "b", "c", "d"), "omnidirectional", "mecanum_a"),
    (SWERVE, "omnidirectional", "fork_0_joint, fork_1_joint, fork_2_joint"),
    (wheels("a") + wheels("b", axis="0.87 0.5 0") + wheels("c", axis="0.87 -0.5 0"),
     "omnidirectional", "a_joint, b_joint, c_joint"),
])  # fmt: skip
def test_the_drive_is_read_from_names_and_axes_of_wheels(changed, text, drive, named):
    urdf = parse_urdf(changed(("</robot>", f"{text}</robot>")))
    found, why = find_drive(urdf, find_arm(urdf, None, "dolly"), urdf)
    assert found == drive
    assert named in why


X, Y, YAW = ("prismatic", "1 0 0"), ("prismatic", "0 1 0"), ("continuous", "0 0 1")


@pytest.mark.parametrize(
    ("joints", "drive"), [((X, Y, YAW), "omnidirectional"), ((X, YAW), "differential")]
)
def test_without_wheels_the_drive_is_read_from_planar_joints(changed, few, joints, drive):
    links = [*(f"frame_{i}" for i in range(len(joints))), "base"]
    chain = "".join(
        f'<link name="{parent}"/><joint name="to_{child}" type="{kind}"><parent link="{parent}"/>'
        f'<child link="{child}"/><axis xyz="{axis}"/>'
        '<limit lower="-9" upper="9" velocity="1"/></joint>'
        for parent, child, (kind, axis) in zip(links, links[1:], joints, strict=False)
    )
    draft = draft_robot(changed(("</robot>", f"{chain}</robot>")), "dolly")
    assert draft.spec.base.drive == drive
    assert draft.guesses.drive.startswith("planar")


MESH = '<box size="0.04 0.1 0.04"/>', '<mesh filename="package://dolly/palm.stl"/>'


def test_meshes_are_left_out_or_found_elsewhere(changed):
    path = changed(MESH)
    bare = read_description(path, path.parent, meshes=False)
    assert not list(bare.xml.iter("mesh"))
    assert len(list(bare.xml.iter("box"))) == 3
    moved = read_description(path, path.parent, mesh_paths={"package://dolly": "/elsewhere"})
    assert [mesh.get("filename") for mesh in moved.xml.iter("mesh")] == ["/elsewhere/palm.stl"]
    with pytest.raises(KinfeasError, match=r"changed\.urdf.*package://doll_"):
        read_description(path, path.parent, mesh_paths={"package://doll_": "/elsewhere"})


TELESCOPE = "".join(
    f'<link name="{link}"/><joint name="{link}_slide" type="prismatic"><parent link="{parent}"/>'
    f'<child link="{link}"/><axis xyz="{axis}"/>'
    f'<limit lower="0" upper="{upper}" velocity="1" effort="0"/></joint>'
    for link, parent, axis, upper in (
        ("first", "palm", "1 0 0", 0.1), ("second", "first", "1 0 0", 0.1),
        ("third", "second", "1 0 0", 0.1), ("across", "third", "0 1 0", 0.1),
        ("longer", "across", "0 1 0", 0.2),
    )
)  # fmt: skip


def test_segments_of_a_telescope_follow_the_first_without_effort_limits_of_0(changed, tmp_path):
    path = changed(("</robot>", f"{TELESCOPE}</robot>"))
    urdf = urdf_of(read_description(path, tmp_path))
    assert urdf.joints["first_slide"].effort == math.inf
    assert {j.name: urdf.followed(j)[0].name for j in urdf.joints.values() if j.mimic} == {
        "second_slide": "first_slide", "third_slide": "first_slide",
    }  # fmt: skip
    assert any("second_slide, third_slide follow first_slide" in text for text in doubts(urdf))


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
  <actuator><position joint="flex" forcerange="-3 3" gear="2"/>
    <motor joint="l" ctrlrange="-4 4" gear="3"/></actuator>
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
    urdf = urdf_of(boxed_urdf(element, cart.parent))
    assert urdf.root == "cart"
    arm = find_arm(urdf, None, "cart")
    assert [joint.name for joint in arm.joints] == ["pan", "tilt", "flex"]
    pan, tilt, flex = arm.joints
    assert (pan.lower, pan.upper, pan.damping) == pytest.approx((-1.4, 1.6, 0.5))
    assert (tilt.effort, flex.effort, flex.kind) == (9.0, 6.0, "continuous")
    assert (urdf.joints["l"].effort, urdf.joints["r"].effort) == (12.0, math.inf)
    # Other programs need both limits.
    assert all({"effort", "velocity"} <= limit.attrib.keys() for limit in element.xml.iter("limit"))
    assert urdf.followed(urdf.joints["r"])[1:] == (-1.0, 0.0)
    kinds = {name: [shape.kind for shape in link.shapes] for name, link in urdf.links.items()}
    assert kinds["hand"] == ["cylinder", "sphere", "sphere"]
    assert (kinds["left"], kinds["right"]) == (["box"], ["cylinder"])
    wedge = max(shape.reach(np.array([0.0, 1.0, 0.0])) for shape in urdf.links["lower"].shapes)
    assert wedge == pytest.approx(0.2, abs=0.01)
    assert urdf.links["hand"].mass == pytest.approx(1.0)


TABLE = '<geom type="box" size="1 1 0.4" pos="3 0 0.4"/><body name="shelf"><geom size="1"/></body>'
CUP = '<body name="cup" pos="1 0 1"><freejoint/><geom size="0.04"/></body>'


@pytest.mark.parametrize(("base", "furniture"), [
    ('<joint name="x" type="slide" axis="1 0 0"/>', set()),
    ("<freejoint/>", set()),
    ("", {"world_link", "shelf"}),  # on which an arm may stand
])  # fmt: skip
def test_an_mjcf_is_imported_without_its_scenery(tmp_path, base, furniture):
    pytest.importorskip("mujoco")
    path, arm = tmp_path / "scene.xml", '<joint name="pan"/><geom size="0.1"/>'
    path.write_text(
        f'<mujoco><worldbody>{TABLE}{CUP}<body name="base">{base}<geom size="0.2"/>'
        f'<body name="arm">{arm}</body></body></worldbody></mujoco>'
    )
    links = urdf_of(read_description(path, tmp_path)).links
    assert {name for name, link in links.items() if link.shapes} == {"base", "arm", *furniture}


def test_a_free_robot_drives_from_its_own_place(tmp_path):
    pytest.importorskip("mujoco")
    path = tmp_path / "scene.xml"
    path.write_text("""<mujoco><worldbody><body name="base" pos="3 2 0.1" euler="90 40 0">
        <freejoint/><geom size="0.2"/>
        <body name="arm"><joint name="pan"/><geom size="0.1"/></body>
    </body></worldbody></mujoco>""")
    pose = urdf_of(read_description(path, tmp_path)).link_poses({})["base"]
    assert_near(pose, [0.0, 0.0, 0.1, 0.5**0.5, 0.0, 0.0, 0.5**0.5], 1e-9, 1e-6)


def test_no_link_has_the_name_of_the_floor(tmp_path):
    path = tmp_path / "robot.urdf"
    path.write_text("""<robot name="r"><link name="world"/><link name="base"/>
        <joint name="fixed" type="fixed"><parent link="world"/><child link="base"/></joint></robot>
    """)
    assert urdf_of(read_description(path, tmp_path)).root == "world_link"


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
    with pytest.raises(KinfeasError, match=r"dolly\.urdf\.xacro.*'lenght'.*known are length"):
        read_description(path, tmp_path, arguments={"lenght": "3"})
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
