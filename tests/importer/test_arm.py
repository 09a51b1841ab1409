import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kinfeas.core.errors import KinfeasError
from kinfeas.importer.arm import find_arm, read_hand
from kinfeas.robots.loading import load_robot
from kinfeas.robots.urdf_file import parse_urdf


def fixed(joint, kind="prismatic"):
    return f'name="{joint}" type="{kind}"', f'name="{joint}" type="fixed"'


WITHOUT_FINGERS = fixed("l"), fixed("r")


def arm_of(path):
    return find_arm(parse_urdf(path), None, "dolly")


def names(joints):
    return [joint.name for joint in joints]


@pytest.mark.parametrize("name", ["tiago", "hsr"])
def test_finds_the_arms_of_shipped_robots(name):
    robot = load_robot(name)
    arm = find_arm(robot.urdf, None, name)
    assert names(arm.joints) == names(robot.arm)
    assert arm.hand in robot.urdf.rigid[robot.ee_frame]
    assert set(names(arm.fingers)) == set(robot.gripper.fingers)


def test_of_several_arms_one_is_chosen():
    urdf = load_robot("pr2").urdf
    with pytest.raises(KinfeasError, match=r"pr2.*r_gripper_palm_link or l_gripper_palm_link"):
        find_arm(urdf, None, "pr2")
    assert find_arm(urdf, "l_gripper_palm_link", "pr2").joints[-1].name == "l_wrist_roll_joint"


ON_TOOL = '<parent link="palm"/><child link="left"/>', '<parent link="tool"/><child link="left"/>'
NO_ROOM = 'lower="-2" upper="2"', 'lower="1" upper="1"'


@pytest.mark.parametrize(("changes", "joints", "fingers"), [
    ((), ["pan", "lift", "elbow"], ["l", "r"]),
    (WITHOUT_FINGERS, ["pan", "lift", "elbow"], []),
    ((fixed("r"),), ["pan", "lift", "elbow"], ["l"]),  # a jaw closes on a fixed one
    ((ON_TOOL,), ["pan", "lift", "elbow"], ["l", "r"]),
    ((NO_ROOM,), ["pan", "elbow"], ["l", "r"]),
])  # fmt: skip
def test_the_hand_is_at_the_end_of_the_longest_chain(changed, changes, joints, fingers):
    arm = arm_of(changed(*changes))
    assert (arm.hand, names(arm.joints), names(arm.fingers)) == ("palm", joints, fingers)
    assert names(arm.stuck) == (["lift"] if NO_ROOM in changes else [])


def test_robots_without_an_arm_are_errors(dolly, changed):
    with pytest.raises(KinfeasError, match=r"^dolly: .*'plam'.*'palm'"):
        find_arm(parse_urdf(dolly), "plam", "dolly")
    with pytest.raises(KinfeasError, match=r"^dolly: .*'base'"):
        find_arm(parse_urdf(dolly), "base", "dolly")
    with pytest.raises(KinfeasError, match=r"^dolly: no arm"):
        arm_of(changed(('type="revolute"', 'type="fixed"'), ("continuous", "fixed")))


def axes(quaternion):
    """The approach, the finger axis and the third, as columns."""
    return Rotation.from_quat(quaternion).inv().as_matrix()


@pytest.mark.parametrize("name", ["pr2", "hsr"])
def test_shipped_hands_have_the_axes_of_their_files(name):
    robot = load_robot(name)
    hand = read_hand(robot.urdf, find_arm(robot.urdf, robot.ee_frame, name))
    found, known = axes(hand.rotation), axes(robot.gripper_rotation)
    np.testing.assert_allclose(found[:, 0], known[:, 0], atol=1e-9)
    np.testing.assert_allclose(np.abs(found[:, 1]), np.abs(known[:, 1]), atol=1e-9)
    np.testing.assert_allclose(hand.tip, robot.tool_tip, atol=0.03)


MIRRORED = (
    '<axis xyz="0 -1 0"/>\n    <limit lower="0" upper="0.04"',
    '<axis xyz="0 1 0"/>\n    <limit lower="-0.04" upper="0"',
)
MIMIC = 'effort="20"/></joint>', 'effort="0"/><mimic joint="l" multiplier="-1"/></joint>'
BOX = '<geometry><box size="0.1 0.02 0.02"/></geometry>'
NO_EFFORT = ('effort="30"', 'effort="0"'), ('effort="20"', 'effort="1e9"')
NO_SHAPES = f'<collision><origin xyz="0.05 0 0"/>{BOX}</collision>', ""


@pytest.mark.parametrize(("changes", "right"), [
    ((), 0.04), ((MIRRORED,), -0.04), ((MIRRORED, MIMIC), -0.04), (NO_EFFORT, 0.04),
])  # fmt: skip
def test_fingers_that_slide_are_a_gripper(changed, changes, right):
    path = changed(*changes)
    hand = read_hand(parse_urdf(path), arm_of(path))
    # 25 mm before the ends of the fingers.
    np.testing.assert_allclose(hand.tip, [0.095, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(hand.rotation, [0.0, 0.0, 0.0, 1.0], atol=1e-9)
    assert MIMIC in changes or hand.gripper.effort == 20.0  # that of r, or a guess
    assert hand.gripper.positions("close") == {"l": 0.0, "r": 0.0}
    assert hand.gripper.positions("open") == {"l": 0.04, "r": right}


def test_a_frame_ahead_of_a_hand_without_fingers_is_the_tool_tip(changed):
    ahead = '<child link="tool"/>', '<child link="tool"/><origin xyz="0.3 0 0"/>'
    urdf = parse_urdf(changed(*WITHOUT_FINGERS, ahead))
    hand = read_hand(urdf, find_arm(urdf, "tool", "dolly"))
    np.testing.assert_allclose(hand.tip, 0.0, atol=1e-9)


@pytest.mark.parametrize(("changes", "named"), [
    (WITHOUT_FINGERS, "'palm'"),
    ((fixed("r"),), "'palm': l"),
    ((NO_SHAPES,), "no collision shapes"),
    ((('name="r" type="prismatic"', 'name="r" type="revolute"'), ('upper="0.04"', 'upper="0"')),
     "l, r"),
])  # fmt: skip
def test_a_hand_without_a_gripper_names_the_reason(changed, changes, named):
    path = changed(*changes)
    hand = read_hand(parse_urdf(path), arm_of(path))
    assert hand.gripper is None
    assert named in hand.no_gripper
