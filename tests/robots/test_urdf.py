import math
from pathlib import Path

import numpy as np
import pinocchio
import pytest
import yaml
from scipy.spatial.transform import Rotation

from kinfeas import robots
from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import IDENTITY, Array, compose, distance, make_pose
from kinfeas.robots.urdf import Joint, Urdf, parse_urdf

SHIPPED = {name: getattr(robots, name)().with_suffix(".urdf") for name in ("pr2", "tiago", "hsr")}
GOLDEN = yaml.safe_load((Path(__file__).parent / "golden_fk.yaml").read_text())
CASES = [
    pytest.param(name, dict(zip(chain["joints"], case["positions"], strict=True)), case["frames"],
                 id=f"{name}-{chain['joints'][-1]}-{case['name']}")
    for name, chains in GOLDEN.items() for chain in chains for case in chain["cases"]
]  # fmt: skip

ARM = """
<robot name="arm">
  <link name="base"/>
  <link name="hand">
    <inertial>
      <mass value="0.5"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>
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
FINGER = """
  <link name="finger"/>
  <joint name="knuckle" type="prismatic">
    <parent link="hand"/><child link="finger"/>
    <limit lower="0" upper="1" velocity="1"/><mimic joint="elbow" multiplier="2"/>
  </joint>
</robot>
"""


def write(folder: Path, text: str) -> Path:
    path = folder / "arm.urdf"
    path.write_text(text)
    return path


def place(urdf: Urdf, frame: str, positions: dict[str, float]) -> Array:
    pose = IDENTITY
    for joint in urdf.path_to(frame):
        moved = motion(joint, positions.get(joint.name, 0.0))
        pose = compose(compose(pose, joint.origin), moved)
    return pose


def motion(joint: Joint, position: float) -> Array:
    along = np.array(joint.axis) * position
    if joint.kind == "prismatic":
        return make_pose(along, Rotation.identity())
    return make_pose(np.zeros(3), Rotation.from_rotvec(along))


@pytest.mark.parametrize(("name", "positions", "frames"), CASES)
def test_parsed_tree_reproduces_golden_poses(name, positions, frames):
    urdf = parse_urdf(SHIPPED[name])
    for frame, expected in frames.items():
        metres, radians = distance(place(urdf, frame, positions), np.array(expected))
        assert metres < 1e-9
        assert radians < 1e-7  # the arc cosine of what differs from 1 by one part in 1e16


@pytest.mark.parametrize(("name", "positions", "frames"), CASES)
def test_pinocchio_reproduces_golden_poses(name, positions, frames):
    model = pinocchio.buildModelFromUrdf(str(SHIPPED[name]))
    data, q = model.createData(), pinocchio.neutral(model)
    for joint, position in positions.items():
        found = model.joints[model.getJointId(joint)]
        continuous = found.nq == 2
        values = [math.cos(position), math.sin(position)] if continuous else [position]
        q[found.idx_q : found.idx_q + found.nq] = values
    pinocchio.framesForwardKinematics(model, data, q)
    for frame, expected in frames.items():
        placement = data.oMf[model.getFrameId(frame)]
        turn = Rotation.from_quat(expected[3:]).as_matrix()
        np.testing.assert_allclose(placement.translation, expected[:3], rtol=0, atol=1e-9)
        np.testing.assert_allclose(placement.rotation, turn, rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("name", "joints", "moving", "mass"),
    [("pr2", 34, 25, 263.0), ("tiago", 18, 12, 63.0), ("hsr", 21, 17, 32.4)],
)
def test_pybullet_loads(name, joints, moving, mass):
    pybullet = pytest.importorskip("pybullet")
    client = pybullet.connect(pybullet.DIRECT)
    try:
        body = pybullet.loadURDF(str(SHIPPED[name]), useFixedBase=True, physicsClientId=client)
        infos = [
            pybullet.getJointInfo(body, i, physicsClientId=client)
            for i in range(pybullet.getNumJoints(body, physicsClientId=client))
        ]
        masses = [
            pybullet.getDynamicsInfo(body, i, physicsClientId=client)[0] for i in range(-1, joints)
        ]
    finally:
        pybullet.disconnect(client)
    assert len(infos) == joints
    assert sum(info[2] != pybullet.JOINT_FIXED for info in infos) == moving
    assert sum(masses) == pytest.approx(mass, abs=0.1)


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_inertias_are_those_of_solid_bodies(name):
    for inertia in pinocchio.buildModelFromUrdf(str(SHIPPED[name])).inertias[1:]:
        small, middle, large = np.linalg.eigvalsh(inertia.inertia)
        assert small > 0.0
        assert small + middle >= large * (1.0 - 1e-6)


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_urdfs_hold_no_soft_limits_and_no_meshes(name):
    urdf = parse_urdf(SHIPPED[name])
    assert not any(link.mesh_collisions for link in urdf.links.values())
    for joint in urdf.joints.values():
        assert (joint.soft_lower, joint.soft_upper) == (joint.lower, joint.upper)


def test_reads_links_and_joints(tmp_path):
    urdf = parse_urdf(write(tmp_path, ARM))
    assert (urdf.name, urdf.root, list(urdf.links)) == ("arm", "base", ["base", "hand"])
    hand, elbow = urdf.links["hand"], urdf.joints["elbow"]
    assert (hand.mass, hand.mesh_collisions, len(hand.shapes)) == (0.5, True, 1)
    assert (hand.shapes[0].kind, hand.shapes[0].size) == ("box", (1.0, 2.0, 3.0))
    np.testing.assert_array_equal(hand.shapes[0].pose, IDENTITY)
    assert (elbow.parent, elbow.child, elbow.axis) == ("base", "hand", (0.0, 0.6, 0.8))
    np.testing.assert_allclose(elbow.origin, [1, 2, 3, 0, 0, 0.5**0.5, 0.5**0.5])
    assert (elbow.lower, elbow.upper, elbow.velocity, elbow.effort) == (-1.0, 2.0, 3.0, 4.0)
    assert (elbow.soft_lower, elbow.soft_upper, elbow.mimic) == (-1.0, 2.0, None)


def test_what_stands_for_no_limit_is_allowed(tmp_path):
    text = ARM.replace('lower="-1" upper="2"', 'lower="-1e16" upper="1e16"')
    elbow = parse_urdf(write(tmp_path, text)).joints["elbow"]
    assert (elbow.lower, elbow.upper) == (-1e16, 1e16)


def test_reads_soft_limits(tmp_path):
    soft = '<safety_controller soft_lower_limit="-0.5" soft_upper_limit="1.5"/></joint>'
    elbow = parse_urdf(write(tmp_path, ARM.replace("</joint>", soft))).joints["elbow"]
    assert (elbow.soft_lower, elbow.soft_upper) == (-0.5, 1.5)
    assert (elbow.lower, elbow.upper) == (-1.0, 2.0)


def test_continuous_joint_needs_no_limit(tmp_path):
    limit = '<limit lower="-1" upper="2" velocity="3" effort="4"/>'
    text = ARM.replace("revolute", "continuous").replace(limit, "")
    elbow = parse_urdf(write(tmp_path, text)).joints["elbow"]
    assert (elbow.lower, elbow.upper, elbow.velocity) == (-math.inf, math.inf, math.inf)


def test_reads_mimic(tmp_path):
    urdf = parse_urdf(write(tmp_path, ARM.replace("</robot>", FINGER)))
    mimic = urdf.joints["knuckle"].mimic
    assert mimic is not None
    assert (mimic.joint, mimic.multiplier, mimic.offset) == ("elbow", 2.0, 0.0)
    assert [joint.name for joint in urdf.path_to("finger")] == ["elbow", "knuckle"]
    assert urdf.path_to("base") == ()


def test_a_fixed_joint_needs_no_axis_whatever_its_file_says(tmp_path):
    fixed = '<joint name="elbow" type="fixed"><parent link="base"/><child link="hand"/>'
    links = '<link name="base"/><link name="hand"/>'
    text = f'<robot name="arm">{links}{fixed}<axis xyz="0 0 0"/></joint></robot>'
    assert parse_urdf(write(tmp_path, text)).joints["elbow"].kind == "fixed"


def test_a_limit_that_is_not_given_is_zero_as_the_format_has_it(tmp_path):
    elbow = parse_urdf(write(tmp_path, ARM.replace('lower="-1" ', ""))).joints["elbow"]
    assert (elbow.lower, elbow.upper) == (0.0, 2.0)


def test_followers_lead_to_the_joint_that_moves_by_itself(tmp_path):
    tip = FINGER.replace("finger", "tip").replace("hand", "finger").replace("knuckle", "end")
    tip = tip.replace('joint="elbow" multiplier="2"', 'joint="knuckle" multiplier="-3" offset="1"')
    finger = FINGER.replace('"2"/>', '"2" offset="0.5"/>').replace("</robot>", tip)
    urdf = parse_urdf(write(tmp_path, ARM.replace("</robot>", finger)))
    elbow = urdf.joints["elbow"]
    assert urdf.followed(elbow) == (elbow, 1.0, 0.0)
    assert urdf.followed(urdf.joints["knuckle"]) == (elbow, 2.0, 0.5)
    assert urdf.followed(urdf.joints["end"]) == (elbow, -6.0, -0.5)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("</robot>", "", "not XML"),
        ("<robot", "<!DOCTYPE robot><robot", "document types and entities are not allowed"),
        (
            "<robot",
            '<!DOCTYPE r [<!ENTITY a "1"><!ENTITY b "&a;&a;">]><robot',
            "document types and entities are not allowed",
        ),
        ('<robot name="arm">', '<?xml version="1.0" encoding="nonsense"?><robot>', "not XML"),
        ('robot name="arm"', "robot", "'name' is missing"),
        ('link name="hand"', 'link name="base"', "link 'base': there are two links"),
        ('link name="base"', 'link name=" "', "'name' is missing or blank"),
        (
            'mass value="0.5"',
            'mass value="nan"',
            "link 'hand', <inertial>, <mass>: 'value' must be",
        ),
        ('mass value="0.5"', 'mass value="-1"', "'value' must be at least 0, not -1"),
        ('mass value="0.5"', "mass", "<mass>: the attribute 'value' is missing"),
        ('ixx="1"', 'ixx="inf"', "<inertia>: 'ixx' must be a finite number, not 'inf'"),
        ('ixx="1"', 'ixx="-1"', "'ixx' must be at least 0"),
        ('mass value="0.5"', 'mass value="1e308"', "must be at most 100000 in size, not 1e.308"),
        ('ixx="1"', 'ixx="1e9"', "'ixx' must be at most 1e.07 in size, not 1e.09"),
        ('<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>', "", "<inertia> is missing"),
        ('filename="hand.stl"', "", "<mesh>: the attribute 'filename' is missing"),
        ('filename="hand.stl"', 'filename="a.stl" scale="1"', "'scale' must be 3 finite numbers"),
        ('size="1 2 3"', 'size="1 2e5 3"', "'size' must be at most 10000 in size, not 200000"),
        ('xyz="1 2 3"', 'xyz="1 -2e5 3"', "'xyz' must be at most 10000 in size, not -200000"),
        ('xyz="0 3 4"', 'xyz="0 0 1e200"', "'xyz' must be at most 1e.16 in size, not 1e.200"),
        ('lower="-1"', 'lower="-1e308"', "'lower' must be at most 1e.16 in size, not -1e.308"),
        ('size="1 2 3"', 'size="1 2"', "'size' must be 3 finite numbers, not '1 2'"),
        ('size="1 2 3"', 'size="1 -2 3"', "'size' must be above 0, not -2"),
        ('size="1 2 3"', 'size="1 two 3"', "'size' must be 3 finite numbers"),
        ('<box size="1 2 3"/>', '<sphere radius="0"/>', "'radius' must be above 0"),
        ('<box size="1 2 3"/>', '<cylinder radius="1"/>', "<cylinder>: the attribute 'length'"),
        ('<box size="1 2 3"/>', "<cone/>", "must hold a <box>, <cylinder>, <sphere> or <mesh>"),
        ('<geometry><box size="1 2 3"/></geometry>', "", "<collision>: <geometry> is missing"),
        ('"revolute"', '"floating"', "joint 'elbow': type must be one of fixed, .* not 'floating'"),
        ('"revolute"', '"planar"', "not 'planar'"),
        ('xyz="1 2 3"', 'xyz="1 2 1e999"', "joint 'elbow', <origin>: 'xyz' must be 3 finite"),
        ('xyz="1 2 3"', 'xyz="1 2 1_0"', "'xyz' must be 3 finite numbers"),
        ('xyz="0 3 4"', 'xyz="0 0 0"', "joint 'elbow': the axis must not be zero"),
        ("<limit ", "<limits ", "joint 'elbow': <limit> is missing"),
        ('velocity="3"', 'velocity="-3"', "'velocity' must be at least 0"),
        ('upper="2"', 'upper="-2"', "'lower' is -1, above 'upper', which is -2"),
        ('lower="-1"', 'lower="3"', "'lower' is 3, above 'upper', which is 2"),
        ('parent link="base"', 'parent link="bass"', "joint 'elbow': there is no link 'bass'"),
        ('child link="hand"', 'child link="hnad"', "joint 'elbow': there is no link 'hnad'"),
        ('<child link="hand"/>', "", "joint 'elbow': <child> is missing"),
        ('child link="hand"', 'child link="base"', "link 'base' hangs on a closed loop|one root"),
        ("</robot>", '<link name="lone"/></robot>', "one root link is allowed, not base, lone"),
        (
            "</joint>",
            '<safety_controller soft_lower_limit="-2" soft_upper_limit="1"/></joint>',
            "soft limits -2 to 1 must lie in -1 to 2",
        ),
        ("</joint>", '<dynamics damping="-1"/></joint>', "'damping' must be at least 0"),
        ("</joint>", '<mimic joint="knee"/></joint>', "<mimic>: there is no moving joint 'knee'"),
        ("</joint>", '<mimic joint="elbow"/></joint>', "<mimic>: the joint follows itself"),
    ],
)
def test_broken_urdf_is_one_sentence(tmp_path, old, new, message):
    assert old in ARM
    path = write(tmp_path, ARM.replace(old, new).strip())
    with pytest.raises(KinfeasError, match=message) as caught:
        parse_urdf(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def following(name, leader, scale, offset=0.0):
    """Return a link and a joint that follows another one."""
    mimic = f'<mimic joint="{leader}" multiplier="{scale}" offset="{offset}"/>'
    place = f'<parent link="hand"/><child link="{name}"/><limit velocity="1"/>'
    return f'<link name="{name}"/><joint name="{name}" type="revolute">{place}{mimic}</joint>'


@pytest.mark.parametrize(
    "joints",
    [
        following("a", "elbow", 1e16),
        following("a", "elbow", 1.0, -1e16),
        following("a", "elbow", 200.0) + following("b", "a", -200.0),
        following("a", "elbow", 1.0, 200.0) + following("b", "a", 200.0),
        "".join(following(f"a{i}", f"a{i - 1}" if i else "elbow", 1e16, 1e16) for i in range(25)),
    ],
)
def test_joints_do_not_follow_out_of_all_bounds(tmp_path, joints):
    path = write(tmp_path, ARM.replace("</robot>", f"{joints}</robot>"))
    with pytest.raises(KinfeasError, match=rf"^{path}: joint '\w+', <mimic>: .* at most 10000 in"):
        parse_urdf(path)


@pytest.mark.parametrize(
    ("joints", "message"),
    [
        ('<joint name="loop" type="fixed"><parent link="hand"/><child link="base"/></joint>',
         "link 'base' hangs on a closed loop of joints"),
        ('<joint name="elbow" type="fixed"><parent link="hand"/><child link="base"/></joint>',
         "joint 'elbow': there are two joints of this name"),
        ('<joint name="again" type="fixed"><parent link="base"/><child link="hand"/></joint>',
         "joint 'again': link 'hand' hangs on another joint, too"),
        ('<link name="a"/><link name="b"/>'
         '<joint name="ab" type="fixed"><parent link="a"/><child link="b"/></joint>'
         '<joint name="ba" type="fixed"><parent link="b"/><child link="a"/></joint>',
         "link 'a' hangs on a closed loop of joints"),
    ],
)  # fmt: skip
def test_links_have_to_form_a_tree(tmp_path, joints, message):
    with pytest.raises(KinfeasError, match=message):
        parse_urdf(write(tmp_path, ARM.replace("</robot>", f"{joints}</robot>")))


def test_missing_file_and_folder_are_named(tmp_path):
    for path in (tmp_path / "none.urdf", tmp_path):
        with pytest.raises(KinfeasError, match=rf"{path}: cannot be read: "):
            parse_urdf(path)


def test_other_xml_is_refused(tmp_path):
    with pytest.raises(KinfeasError, match="the first element must be <robot>, not <sdf>"):
        parse_urdf(write(tmp_path, "<sdf/>"))
    with pytest.raises(KinfeasError, match="there is no <link>"):
        parse_urdf(write(tmp_path, '<robot name="empty"/>'))
