import math
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.robots.elements import Element, find_mesh
from kinfeas.robots.urdf_file import parse_urdf

ARM = """
<robot name="arm">
  <link name="base"/>
  <link name="hand">
    <inertial>
      <origin xyz="0 0.1 0.2"/><mass value="0.5"/>
      <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>
    </inertial>
    <collision><geometry><box size="1 2 3"/></geometry></collision>
    <collision><origin xyz="0 0 1"/><geometry><mesh filename="hand.stl"/></geometry></collision>
  </link>
  <joint name="elbow" type="revolute">
    <parent link="base"/><child link="hand"/>
    <origin xyz="1 2 3" rpy="0 0 1.5707963267948966"/><axis xyz="0 3 4"/>
    <limit lower="-1" upper="2" velocity="3" effort="4"/>
  </joint>
</robot>
"""


def write(folder: Path, text: str) -> Path:
    path = folder / "arm.urdf"
    path.write_text(text)
    return path


def fixed(name, parent, child):
    links = f'<parent link="{parent}"/><child link="{child}"/>'
    return f'<joint name="{name}" type="fixed">{links}</joint></robot>'


FLOATING = (
    '<link name="drone"/><joint name="free" type="floating"><parent link="hand"/>'
    '<child link="drone"/></joint></robot>'
)
SOFT = '<safety_controller soft_lower_limit="-0.5" soft_upper_limit="1.5"/></joint>'


@pytest.mark.parametrize(("old", "new", "expected"), [
    ('lower="-1" upper="2"', 'lower="-1e16" upper="1e16"', {"lower": -1e16, "upper": 1e16}),
    ('lower="-1" ', "", {"lower": 0.0, "upper": 2.0}),
    ("</joint>", SOFT, {"lower": -1.0, "soft_lower": -0.5, "soft_upper": 1.5}),
    ("</joint>", SOFT.replace("-0.5", "-2"), {"lower": -1.0, "soft_lower": -1.0}),
    ("</joint>", SOFT.replace("1.5", "9"), {"upper": 2.0, "soft_upper": 2.0}),
    ('"revolute"', '"continuous"', {"lower": -math.inf, "upper": math.inf, "velocity": 3.0}),
    ('type="revolute"', 'type="fixed"', {"lower": 0.0, "velocity": 0.0, "moves": False}),
])  # fmt: skip
def test_reads_limits(tmp_path, old, new, expected):
    elbow = parse_urdf(write(tmp_path, ARM.replace(old, new))).joints["elbow"]
    assert {key: getattr(elbow, key) for key in expected} == expected


def test_a_capsule_is_a_cylinder_with_spheres_at_its_ends(tmp_path):
    capsule = '<box size="1 2 3"/>', '<capsule radius="0.1" length="0.4"/>'
    turned = "<collision><geometry><box", '<collision><origin rpy="0 1.5708 0"/><geometry><box'
    hand = parse_urdf(write(tmp_path, ARM.replace(*turned).replace(*capsule))).links["hand"]
    assert sorted(shape.kind for shape in hand.shapes) == ["cylinder", "sphere", "sphere"]
    assert hand.mesh_collisions
    for axis, reach in ((0, 0.3), (1, 0.1), (2, 0.1)):
        for direction in (np.eye(3)[axis], -np.eye(3)[axis]):
            result = max(shape.reach(direction) for shape in hand.shapes)
            assert result == pytest.approx(reach, abs=1e-4)


@pytest.mark.parametrize("kind", ["planar", "floating"])
@pytest.mark.parametrize("above", ["", "fixed"])
def test_the_joint_between_world_and_base_is_left_out(tmp_path, kind, above):
    world = f'<link name="world"/>{fixed("m", "world", "odom")[:-8]}<link name="odom"/>'
    world = world if above else '<link name="odom"/>'
    free = '<joint name="free" type="{}"><parent link="odom"/><child link="base"/></joint>'
    text = ARM.replace("</robot>", f"{world}{free.format(kind)}</robot>")
    urdf = parse_urdf(write(tmp_path, text))
    assert (urdf.root, list(urdf.links), list(urdf.joints)) == ("base", ["base", "hand"], ["elbow"])
    box = '<visual><geometry><box size="1 1 1"/></geometry></visual>'
    shaped = text.replace('<link name="odom"/>', f'<link name="odom">{box}</link>')
    with pytest.raises(KinfeasError, match=f"joint 'free': type '{kind}'"):
        parse_urdf(write(tmp_path, shaped))


@pytest.mark.parametrize(("old", "new", "where"), [
    ("</robot>", "", "XML"),
    ("<robot", '<!DOCTYPE r [<!ENTITY a "1">]><robot', "document types"),
    ('ixx="1"', 'ixx="-1"', "'ixx'"),
    ('xyz="1 2 3"', 'xyz="1 2 1e999"', "joint 'elbow', <origin>: 'xyz'"),
    ('<box size="1 2 3"/>', '<cylinder radius="1"/>', "<cylinder>: the attribute 'length'"),
    ('"revolute"', '"ball"', "joint 'elbow': type"),
    ('upper="2"', 'upper="-2"', "'upper'"),
    ('parent link="base"', 'parent link="bass"', "link 'bass'"),
    ("</robot>", '<link name="lone"/></robot>', "base, lone"),
    ("</robot>", FLOATING, "joint 'free': type 'floating'"),
    ("</joint>", '<mimic joint="knee"/></joint>', "<mimic>.*'knee'"),
    ("</robot>", fixed("loop", "hand", "base"), "root"),
])  # fmt: skip
def test_a_broken_urdf_is_an_error_with_its_place(tmp_path, old, new, where):
    assert old in ARM
    path = write(tmp_path, ARM.replace(old, new).strip())
    with pytest.raises(KinfeasError, match=f"^{path}.*{where}"):
        parse_urdf(path)


@pytest.fixture
def rover(tmp_path):
    """The URDF of a robot in the usual layout of a package, with another package beside it."""
    for folder in ("rover/urdf", "rover/meshes", "rover_meshes"):
        (tmp_path / folder).mkdir(parents=True)
    (tmp_path / "rover" / "meshes" / "part.stl").touch()
    (tmp_path / "rover_meshes" / "PART.STL").touch()
    return tmp_path / "rover" / "urdf" / "rover.urdf"


def mesh_of(name, urdf):
    mesh = Element(ElementTree.Element("mesh", filename=name), f"{urdf}: <mesh>")
    return find_mesh(mesh, urdf.absolute().parent, (".stl", ".obj", ".dae"))


@pytest.mark.parametrize(("name", "where"), [
    ("../meshes/part.stl", "rover/meshes/part.stl"),
    ("{0}/rover/meshes/part.stl", "rover/meshes/part.stl"),
    ("file://{0}/rover/meshes/part.stl", "rover/meshes/part.stl"),
    ("package://rover/meshes/part.stl", "rover/meshes/part.stl"),
    ("package:///rover/meshes/part.stl", "rover/meshes/part.stl"),
    ("package://rover_meshes/PART.STL", "rover_meshes/PART.STL"),
])  # fmt: skip
def test_meshes_are_found(rover, tmp_path, monkeypatch, name, where):
    monkeypatch.chdir(tmp_path)
    for urdf in (rover, rover.relative_to(tmp_path)):
        assert mesh_of(name.format(tmp_path), urdf).samefile(tmp_path / where)


@pytest.mark.parametrize(("package", "variable", "root"), [
    ("rover", None, None),  # a clone's folder has another name than its package
    ("ws/src/clone", "ROS_PACKAGE_PATH", "ws/src"),
    ("ws/src/group/clone", "ROS_PACKAGE_PATH", "ws/src"),
    ("ws/src/moon", "ROS_PACKAGE_PATH", "ws/src"),
    ("ws/install/share/moon", "AMENT_PREFIX_PATH", "ws/install"),
])  # fmt: skip
def test_packages_are_found_by_their_names(rover, tmp_path, monkeypatch, package, variable, root):
    monkeypatch.delenv("ROS_PACKAGE_PATH", raising=False)
    monkeypatch.delenv("AMENT_PREFIX_PATH", raising=False)
    part = tmp_path / package / "part.stl"
    part.parent.mkdir(parents=True, exist_ok=True)
    part.touch()
    if not package.endswith("moon"):
        (part.parent / "package.xml").write_text("<package><name> moon </name></package>")
    if variable:
        with pytest.raises(KinfeasError, match=variable):
            mesh_of("package://moon/part.stl", rover)
        monkeypatch.setenv(variable, f"/none:{tmp_path / root}")
    assert mesh_of("package://moon/part.stl", rover) == part


def test_a_pointer_of_git_lfs_is_an_error(rover):
    part = rover.parent / "part.stl"
    part.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n")
    with pytest.raises(KinfeasError, match=r"<mesh>.*part\.stl.*git lfs pull"):
        mesh_of("part.stl", rover)
