import math

import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.importer.arm import find_arm
from kinfeas.importer.description import doubts, find_drive, read_description
from kinfeas.importer.draft import draft_robot
from kinfeas.robots.urdf_file import parse_urdf, urdf_of


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
