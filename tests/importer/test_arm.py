import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.importer.arm import bare_stand, find_arm
from kinfeas.robots.loading import load_robot
from kinfeas.robots.urdf import parse_urdf


@pytest.mark.parametrize("name", ["tiago", "hsr"])
def test_finds_the_arms_of_shipped_robots(name):
    robot = load_robot(name)
    arm = find_arm(robot.urdf, None, name)
    assert [joint.name for joint in arm.joints] == [joint.name for joint in robot.arm]
    assert arm.hand in robot.urdf.rigid[robot.ee_frame]
    assert {finger.name for finger in arm.fingers} == set(robot.gripper.fingers)


def test_two_arms_have_to_be_told_apart():
    urdf = load_robot("pr2").urdf
    hands = "r_gripper_palm_link or l_gripper_palm_link"
    with pytest.raises(KinfeasError, match=f"pr2: there are several arms: .* {hands}"):
        find_arm(urdf, None, "pr2")
    arm = find_arm(urdf, "l_gripper_palm_link", "pr2")
    assert arm.joints[-1].name == "l_wrist_roll_joint"


def test_the_hand_is_where_the_longest_way_parts_into_fingers(dolly):
    arm = find_arm(parse_urdf(dolly), None, "dolly")
    assert arm.hand == "palm"
    assert [joint.name for joint in arm.joints] == ["pan", "lift", "elbow"]
    assert [joint.name for joint in arm.fingers] == ["l", "r"]


def test_without_fingers_it_is_the_last_link(changed):
    fingers = [('name="l" type="prismatic"', 'name="l" type="fixed"')]
    fingers.append(('name="r" type="prismatic"', 'name="r" type="fixed"'))
    assert find_arm(parse_urdf(changed(*fingers)), None, "dolly").hand == "palm"


@pytest.mark.parametrize(
    ("hand", "message"),
    [
        ("plam", r"dolly: there is no link 'plam' \(did you mean 'palm'\?\)"),
        ("base", "no joint moves between 'base' and 'base'"),
    ],
)
def test_links_that_cannot_be_hands_are_one_sentence(dolly, hand, message):
    with pytest.raises(KinfeasError, match=message):
        find_arm(parse_urdf(dolly), hand, "dolly")


def test_a_robot_without_an_arm_is_one_sentence(changed):
    urdf = parse_urdf(changed(('type="revolute"', 'type="fixed"'), ("continuous", "fixed")))
    with pytest.raises(KinfeasError, match="no link has 3 moving joints above it: no arm"):
        find_arm(urdf, None, "dolly")


def test_joints_whose_limits_leave_no_room_are_told_apart(changed):
    path = changed(('lower="-2" upper="2"', 'lower="1" upper="1"'))
    arm = find_arm(parse_urdf(path), None, "dolly")
    assert [joint.name for joint in arm.joints] == ["pan", "elbow"]
    assert [joint.name for joint in arm.stuck] == ["lift"]


def test_links_on_fixed_joints_cannot_move_against_each_other(dolly):
    assert parse_urdf(dolly).rigid["tool"] == {"wrist", "palm", "tool"}


def test_a_jaw_that_closes_on_a_fixed_one_is_no_joint_of_the_arm(changed):
    path = changed(('name="r" type="prismatic"', 'name="r" type="fixed"'))
    arm = find_arm(parse_urdf(path), None, "dolly")
    assert arm.hand == "palm"
    assert [joint.name for joint in arm.joints] == ["pan", "lift", "elbow"]
    assert [joint.name for joint in arm.fingers] == ["l"]


@pytest.mark.parametrize("axis", ["1 0 0", "0 1 0"])
def test_a_last_joint_that_turns_the_hand_is_one_of_the_arm(changed, axis):
    path = changed(
        ('name="l" type="prismatic"', 'name="l" type="fixed"'),
        ('name="r" type="prismatic"', 'name="r" type="fixed"'),
        ('name="mount" type="fixed"', 'name="mount" type="continuous"'),
        ('<axis xyz="0 0 0"/>', f'<axis xyz="{axis}"/>'),
    )
    arm = find_arm(parse_urdf(path), None, "dolly")
    assert [joint.name for joint in arm.joints] == ["pan", "lift", "elbow", "mount"]
    assert not arm.fingers


def test_fingers_on_several_links_hang_on_the_one_before_these(changed):
    path = changed(
        ('<parent link="palm"/><child link="left"/>', '<parent link="tool"/><child link="left"/>')
    )
    assert find_arm(parse_urdf(path), None, "dolly").hand == "palm"


NECK = ('<joint name="neck" type="revolute">', '<joint name="neck" type="fixed">')
HEAD = (
    '<link name="head"><collision><geometry><sphere radius="0.05"/></geometry></collision></link>',
    '<link name="head"/>',
)
SLIDE = ('<joint name="pan" type="continuous">', '<joint name="pan" type="prismatic">')
LIMIT = ('<axis xyz="0 0 1"/></joint>', '<axis xyz="0 0 1"/><limit lower="0" upper="1"/></joint>')


@pytest.mark.parametrize(
    ("changes", "stand"),
    [
        ((), ""),  # a head moves on it
        ((NECK,), ""),  # two bodies
        ((NECK, HEAD), "base"),
        ((NECK, HEAD, SLIDE, LIMIT), ""),  # a lift
    ],
)
def test_an_arm_on_a_single_body_may_have_no_base(changed, changes, stand):
    urdf = parse_urdf(changed(*changes))
    assert bare_stand(urdf, find_arm(urdf, None, "dolly")) == stand


@pytest.mark.parametrize("name", ["pr2", "tiago", "hsr"])
def test_shipped_robots_have_a_base(name):
    robot = load_robot(name)
    assert not bare_stand(robot.urdf, find_arm(robot.urdf, robot.ee_frame, name))
