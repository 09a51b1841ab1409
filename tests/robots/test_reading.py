import math
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import fcl
import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from kinfeas import robots
from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import IDENTITY, Array, compose, make_pose, rotation
from kinfeas.robots.loading import read_robot
from kinfeas.robots.robot import Robot
from kinfeas.robots.urdf import Joint, Shape

SHIPPED = {name: read_robot(getattr(robots, name)()) for name in ("pr2", "tiago", "hsr")}

URDF = """
<robot name="crane">
  <link name="floor"/><link name="mast"/><link name="boom"/><link name="hook"/>
  <link name="flag"/><link name="bell"/><link name="claw"/>
  <joint name="lift" type="prismatic"><parent link="floor"/><child link="mast"/>
    <axis xyz="0 0 1"/><limit lower="0.2" upper="1" velocity="0.1" effort="1"/></joint>
  <joint name="swing" type="revolute"><parent link="mast"/><child link="boom"/>
    <axis xyz="0 0 1"/><limit lower="-2" upper="2" velocity="1" effort="1"/>
    <safety_controller soft_lower_limit="-1.5" soft_upper_limit="1.5"/></joint>
  <joint name="spin" type="continuous"><parent link="boom"/><child link="hook"/></joint>
  <joint name="wave" type="revolute"><parent link="mast"/><child link="flag"/>
    <limit lower="0.5" upper="1" velocity="1" effort="1"/></joint>
  <joint name="ring" type="revolute"><parent link="flag"/><child link="bell"/>
    <limit lower="-9" upper="9" velocity="1" effort="1"/>
    <mimic joint="wave" multiplier="2" offset="0.1"/></joint>
  <joint name="grip" type="revolute"><parent link="hook"/><child link="claw"/>
    <limit lower="-9" upper="9" velocity="1" effort="1"/><mimic joint="swing"/></joint>
</robot>
"""


def crane() -> dict:
    return {
        "name": "crane",
        "urdf": "crane.urdf",
        "ee_frame": "hook",
        "tool_tip": [0.1, 0, 0],
        "gripper_rotation": [0, 0, 0.7071, 0.7071],
        "base": {
            "drive": "differential",
            "max_velocity": 0.2,
            "max_rotation": 1,
            "max_acceleration": 1,
            "max_rotation_acceleration": 2,
        },
        "arm": {"lift": {}, "swing": {"velocity": 0.5}, "spin": {"velocity": 3}},
        "home": {"home": [0.5, 0.0, 9.0], "low": [0.2, 1.5, 0.0]},
        "goal_heights": {"ggr": [0.2, 1.2], "ggr_restricted": [0.4, 1.0]},
    }


def write(folder: Path, spec: dict, urdf: str = URDF) -> Path:
    (folder / "crane.urdf").write_text(urdf)
    path = folder / "crane.yaml"
    path.write_text(yaml.safe_dump(spec, sort_keys=False))
    return path


def test_reads_a_robot(tmp_path):
    robot = read_robot(write(tmp_path, crane()))
    assert (robot.name, robot.ee_frame, robot.base.frame) == ("crane", "hook", "floor")
    assert robot.urdf_path == tmp_path / "crane.urdf"
    assert robot.base.drive == "differential"
    lift, swing, spin = robot.arm
    assert (lift.lower, lift.upper, lift.velocity, lift.continuous) == (0.2, 1.0, 0.1, False)
    assert (swing.lower, swing.upper, swing.velocity) == (-1.5, 1.5, 0.5)
    assert (spin.lower, spin.upper, spin.velocity) == (-math.inf, math.inf, 3.0)
    assert spin.continuous
    np.testing.assert_array_equal(robot.home["low"], [0.2, 1.5, 0.0])
    np.testing.assert_allclose(robot.gripper_rotation, [0, 0, 0.5**0.5, 0.5**0.5])
    np.testing.assert_array_equal(robot.tool_tip, [0.1, 0.0, 0.0])
    assert robot.goal_heights == {"ggr": (0.2, 1.2), "ggr_restricted": (0.4, 1.0)}
    assert (robot.pose_tolerance, robot.ignored_collisions) == (None, frozenset())


def test_says_what_the_arm_can_in_arrays_that_nobody_can_change(tmp_path):
    robot = read_robot(write(tmp_path, crane()))
    expected = (
        (robot.continuous, [False, False, True]),
        (robot.max_joint_velocity, [0.1, 0.5, 3.0]),
        (robot.joint_limits[0], [0.2, -1.5, -math.inf]),
        (robot.joint_limits[1], [1.0, 1.5, math.inf]),
        (robot.finite_joint_limits[0], [0.2, -1.5, -math.pi]),
        (robot.finite_joint_limits[1], [1.0, 1.5, math.pi]),
    )
    for found, values in expected:
        np.testing.assert_array_equal(found, values, strict=True)
        with pytest.raises(ValueError, match="read-only"):
            found[0] = 0.0


def test_another_arm_can_other_things(tmp_path):
    robot = read_robot(write(tmp_path, crane()))
    assert robot.continuous.any()
    assert not replace(robot, arm=robot.arm[:2]).continuous.any()


def test_other_joints_are_as_near_zero_as_they_can_or_follow(tmp_path):
    robot = read_robot(write(tmp_path, crane()))
    assert robot.fixed_joints == pytest.approx({"wave": 0.5, "ring": 1.1})


def test_fixed_joints_move_their_followers(tmp_path):
    robot = read_robot(write(tmp_path, crane() | {"fixed_joints": {"wave": 0.7}}))
    assert robot.fixed_joints == pytest.approx({"wave": 0.7, "ring": 1.5})


def test_a_joint_below_the_ee_may_be_fixed_and_one_above_has_to_be(tmp_path):
    spec = crane() | {"arm": {"lift": {}, "spin": {"velocity": 3}}, "home": {"home": [0.5, 0.0]}}
    with pytest.raises(KinfeasError, match="joint 'swing', on the way to 'hook', must stand in"):
        read_robot(write(tmp_path, spec))
    robot = read_robot(write(tmp_path, spec | {"fixed_joints": {"swing": 0.3}}))
    assert robot.fixed_joints == pytest.approx(
        {"swing": 0.3, "wave": 0.5, "ring": 1.1, "grip": 0.3}
    )


def test_a_joint_above_the_ee_may_follow_the_arm(tmp_path):
    spec = crane() | {"ee_frame": "claw"}
    assert [joint.name for joint in read_robot(write(tmp_path, spec)).arm] == list(spec["arm"])


def test_reads_leeway_and_ignored_collisions(tmp_path):
    spec = crane() | {
        "pose_tolerance": {"position": 0.1, "rotation": 0.2},
        "ignored_collisions": [["mast", "hook"], ["hook", "mast"]],
    }
    robot = read_robot(write(tmp_path, spec))
    assert robot.pose_tolerance is not None
    assert (robot.pose_tolerance.position, robot.pose_tolerance.rotation) == (0.1, 0.2)
    assert robot.ignored_collisions == {frozenset(("mast", "hook"))}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"wheels": 4}, "unknown key 'wheels'"),
        ({"tool_tip": [0.1, 0.0]}, "'tool_tip'"),
        ({"tool_tip": [0.1, 0.0, math.nan]}, r"'tool_tip.2'"),
        ({"urdf": "none.urdf"}, "none.urdf: cannot be read"),
        ({"ee_frame": "hok"}, "'ee_frame': there is no link 'hok' .did you mean 'hook'"),
        ({"gripper_rotation": [0, 0, 1, 1]}, "'gripper_rotation'"),
        ({"base": {"drive": "subgoals"}}, "'base.drive'"),
        (
            {"base": crane()["base"] | {"max_velocity": 0}},
            r"'base.max_velocity'",
        ),
        ({"base": crane()["base"] | {"max_velocity": math.inf}}, "'base.max_velocity' must be"),
        ({"base": crane()["base"] | {"max_velocity": 1e300}}, "base.max_velocity"),
        ({"base": crane()["base"] | {"max_rotation": 101}}, r"'base.max_rotation'"),
        ({"base": crane()["base"] | {"max_acceleration": 1e9}}, "'base.max_acceleration'"),
        ({"name": ""}, "'name' must be printable, not empty and without '/', not ''"),
        ({"name": "a/b"}, "'name' must be printable, not empty and without '/', not 'a/b'"),
        ({"name": "a\nb"}, "'name' must be printable"),
        (
            {"pose_tolerance": {"position": 1e9, "rotation": 0.2}},
            "'pose_tolerance.position' .* not 1000000000.0",
        ),
        (
            {"pose_tolerance": {"position": 0.1, "rotation": 100}},
            r"'pose_tolerance.rotation'",
        ),
        ({"arm": {}}, "'arm' must name at least one joint"),
        ({"arm": {"lfit": {}}}, "'arm.lfit': there is no such joint .did you mean 'lift'"),
        ({"arm": {"grip": {}}, "ee_frame": "claw"}, "'arm.grip': the joint does not move by its"),
        ({"arm": {"lift": {"speed": 1}}}, "unknown key 'arm.lift.speed'"),
        (
            {"arm": {"lift": {"velocity": 0}}},
            r"'arm.lift.velocity'",
        ),
        ({"arm": {"swing": {}, "lift": {}}}, "'arm' must be those on the way .* in order, of lift"),
        (
            {"arm": {"lift": {}, "wave": {}}},
            "'arm' must be those on the way from 'floor' to 'hook'",
        ),
        ({"arm": crane()["arm"] | {"spin": {}}}, "'arm.spin': the URDF gives no velocity above 0"),
        (
            {"arm": crane()["arm"] | {"spin": {"velocity": 3, "soft_limits": [-1, 1]}}},
            "'arm.spin': a continuous joint has no 'soft_limits'",
        ),
        (
            {"arm": crane()["arm"] | {"swing": {"soft_limits": [-3, 1]}}},
            "'arm.swing': the soft limits -3 to 1 must lie in the URDF's -2 to 2",
        ),
        (
            {"tool_tip": [1e300, 0, 0]},
            r"'tool_tip.0'",
        ),
        ({"arm": {"swing": {"soft_limits": [1, -1]}}}, "'arm.swing': 'soft_limits' must ascend"),
        ({"home": {"low": [0.5, 0, 0]}}, "'home' must hold a configuration of the name 'home'"),
        ({"home": {"home": [0.5]}}, "'home.home': must hold 3 joint positions, not 1"),
        ({"home": {"home": [0.1, 0, 0]}}, "'home.home': lift at 0.1 is beyond its soft limits"),
        ({"home": {"home": [0.5, 1.6, 0]}}, "swing at 1.6 is beyond its soft limits -1.5 to 1.5"),
        ({"goal_heights": {"ggr": [0.2, 1.2]}}, "'goal_heights' must hold ggr and ggr_restricted"),
        (
            {"goal_heights": {"ggr": [1.2, 0.2], "ggr_restricted": [0.4, 1.0]}},
            "'goal_heights.ggr' must ascend, not go from 1.2 to 0.2",
        ),
        (
            {"pose_tolerance": {"position": -0.1, "rotation": 0.2}},
            r"'pose_tolerance.position'",
        ),
        ({"fixed_joints": {"wvae": 1.0}}, "'fixed_joints.wvae': there is no such joint"),
        ({"fixed_joints": {"lift": 0.5}}, "'fixed_joints.lift': the joint stands in 'arm', too"),
        (
            {"fixed_joints": {"ring": 0.5}},
            "'fixed_joints.ring': the joint follows 'wave', set that",
        ),
        ({"fixed_joints": {"wave": 0.1}}, "'fixed_joints.wave': 0.1 is beyond the limits 0.5 to 1"),
        ({"ignored_collisions": [["mast", "sea"]]}, "'ignored_collisions': there is no link 'sea'"),
        ({"ignored_collisions": [["mast", "mast"]]}, "must hold pairs of two links, not 'mast'"),
    ],
)
def test_broken_robot_is_one_sentence(tmp_path, changes, message):
    with pytest.raises(KinfeasError, match=message) as caught:
        read_robot(write(tmp_path, crane() | changes))
    assert str(caught.value).startswith(str(tmp_path))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("key", list(crane()))
def test_every_key_is_needed(tmp_path, key):
    spec = crane()
    del spec[key]
    with pytest.raises(KinfeasError, match=f"'{key}' is missing"):
        read_robot(write(tmp_path, spec))


def test_limits_without_a_way_between_them_are_named(tmp_path):
    joint = URDF[URDF.index('<joint name="swing"') : URDF.index('<joint name="spin"')]
    stuck = joint.replace('"-2" upper="2"', '"0" upper="0"').replace("1.5", "0")
    spec = crane() | {"arm": crane()["arm"] | {"swing": {}}}
    with pytest.raises(
        KinfeasError, match=r"'arm\.swing': the lower limit must be below the upper"
    ):
        read_robot(write(tmp_path, spec, URDF.replace(joint, stuck)))


def test_a_velocity_that_stands_for_none_is_none(tmp_path):
    spec = crane() | {"arm": crane()["arm"] | {"swing": {}}}
    swing = URDF.replace('upper="2" velocity="1"', 'upper="2" velocity="1e16"')
    read_robot(write(tmp_path, spec))
    with pytest.raises(KinfeasError, match=r"'arm\.swing': the URDF gives no velocity above 0"):
        read_robot(write(tmp_path, spec, swing))


def led_by_spin(follower: str, multiplier: str) -> str:
    """Return the crane with a claw that follows the endless joint."""
    joint = URDF[URDF.index('<joint name="grip"') : URDF.index("</robot>")]
    told = joint.replace('"revolute"', f'"{follower}"')
    told = told.replace('joint="swing"', f'joint="spin" multiplier="{multiplier}"')
    return URDF.replace(joint, told)


def test_what_follows_an_endless_joint_comes_round_with_it(tmp_path):
    """IK takes angles a whole turn apart for the same."""
    for multiplier in ("1", "-2", "0"):
        read_robot(write(tmp_path, crane(), led_by_spin("revolute", multiplier)))
    for follower, multiplier in (("revolute", "0.5"), ("prismatic", "1")):
        message = "'arm.spin': a turn of it changes where 'grip' stands"
        with pytest.raises(KinfeasError, match=message):
            read_robot(write(tmp_path, crane(), led_by_spin(follower, multiplier)))


def test_a_fixed_joint_has_no_position(tmp_path):
    urdf = URDF.replace('"spin" type="continuous"', '"spin" type="fixed"')
    spec = crane() | {"arm": {"lift": {}, "swing": {}}, "home": {"home": [0.5, 0.0]}}
    assert len(read_robot(write(tmp_path, spec, urdf)).arm) == 2
    with pytest.raises(KinfeasError, match=r"'fixed_joints\.spin': the joint does not move"):
        read_robot(write(tmp_path, spec | {"fixed_joints": {"spin": 0.0}}, urdf))
    with pytest.raises(KinfeasError, match=r"'arm\.spin': the joint does not move"):
        read_robot(write(tmp_path, crane(), urdf))


@pytest.mark.parametrize(
    ("name", "joints", "ee_frame", "tool_tip"),
    [
        ("pr2", 7, "r_wrist_roll_link", [0.18, 0, 0]),
        ("tiago", 8, "arm_tool_link", [0.205, 0, 0]),
        ("hsr", 5, "hand_palm_link", [0, 0, 0.08]),
    ],
)
def test_shipped_arms(name, joints, ee_frame, tool_tip):
    robot = SHIPPED[name]
    assert (robot.name, len(robot.arm), robot.ee_frame) == (name, joints, ee_frame)
    np.testing.assert_array_equal(robot.tool_tip, tool_tip)


@pytest.mark.parametrize(
    ("name", "drive", "limits", "ggr", "restricted"),
    [
        ("pr2", "omnidirectional", (0.2, 1.0), (0.2, 1.2), (0.4, 1.0)),
        ("tiago", "differential", (0.2, 0.4), (0.2, 1.5), (0.4, 1.1)),
        ("hsr", "omnidirectional", (0.2, 1.5), (0.2, 1.4), (0.4, 1.1)),
    ],
)
def test_shipped_limits(name, drive, limits, ggr, restricted):
    robot = SHIPPED[name]
    assert (robot.base.drive, robot.base.frame) == (drive, "base_footprint")
    assert (robot.base.max_velocity, robot.base.max_rotation) == limits
    assert robot.goal_heights == {"ggr": ggr, "ggr_restricted": restricted}


@pytest.mark.parametrize("name", SHIPPED)
def test_tool_tip_lies_ahead_along_the_approach_axis(name):
    robot = SHIPPED[name]
    approach = Rotation.from_quat(robot.gripper_rotation).inv().apply(robot.tool_tip)
    np.testing.assert_allclose(approach, [np.linalg.norm(robot.tool_tip), 0, 0], atol=1e-12)


def test_shipped_gripper_rotations_lay_the_fingers_along_y():
    fingers = {"pr2": [0, 1, 0], "tiago": [0, 0, 1], "hsr": [0, 1, 0]}  # in the EE frame
    for name, axis in fingers.items():
        turn = Rotation.from_quat(SHIPPED[name].gripper_rotation)
        np.testing.assert_allclose(np.abs(turn.inv().apply(axis)), [0, 1, 0], atol=1e-12)


def test_only_hsr_has_leeway():
    assert SHIPPED["pr2"].pose_tolerance is None
    assert SHIPPED["tiago"].pose_tolerance is None
    pose_tolerance = SHIPPED["hsr"].pose_tolerance
    assert pose_tolerance is not None
    assert (pose_tolerance.position, pose_tolerance.rotation) == (
        0.1,
        pytest.approx(math.radians(12), rel=1e-15),
    )


@pytest.mark.parametrize(
    ("name", "configuration"),
    [(name, configuration) for name, robot in SHIPPED.items() for configuration in robot.home],
)
def test_shipped_configurations_are_free_of_self_collision(name, configuration):
    robot = SHIPPED[name]
    assert touching(robot, robot.home[configuration]) == set()


def test_self_collision_is_seen():
    pr2 = SHIPPED["pr2"]
    across = np.array([0.5, 0.8, -1.4, -1.2, 0.0, -0.7, 0.0])  # into the idle left arm
    assert any("l_" in link for pair in touching(pr2, across) for link in pair)


def test_robots_imports_nothing_heavy():
    code = "import sys, kinfeas.robots as r; r.pr2(); print('numpy' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


def touching(robot: Robot, positions: Array) -> set[frozenset[str]]:
    """Return the pairs of links that touch, less those next to each other and those ignored."""
    poses = link_poses(robot, positions)
    body = rigid_bodies(robot)
    joined = {
        frozenset((body[joint.parent], body[joint.child])) for joint in robot.urdf.joints.values()
    }
    solids = [
        (link.name, solid(shape, compose(poses[link.name], shape.pose)))
        for link in robot.urdf.links.values()
        for shape in link.shapes
    ]
    return {
        frozenset((a, b))
        for i, (a, one) in enumerate(solids)
        for b, other in solids[:i]
        if body[a] != body[b]
        and frozenset((body[a], body[b])) not in joined
        and frozenset((a, b)) not in robot.ignored_collisions
        and fcl.collide(one, other, fcl.CollisionRequest(), fcl.CollisionResult())
    }


def rigid_bodies(robot: Robot) -> dict[str, str]:
    """Return, for every link, the topmost link that it is rigidly joined to."""
    body = {}
    for link in robot.urdf.links:
        body[link] = robot.urdf.root
        for joint in robot.urdf.path_to(link):
            if joint.moves:
                body[link] = joint.child
    return body


def link_poses(robot: Robot, positions: Array) -> dict[str, Array]:
    names = [joint.name for joint in robot.arm]
    at = robot.fixed_joints | dict(zip(names, positions.tolist(), strict=True))
    poses = {}
    for link in robot.urdf.links:
        poses[link] = IDENTITY
        for joint in robot.urdf.path_to(link):
            poses[link] = compose(compose(poses[link], joint.origin), motion(joint, at))
    return poses


def motion(joint: Joint, at: dict[str, float]) -> Array:
    if not joint.moves:
        return IDENTITY
    position = at.get(joint.name)
    if position is None:  # it follows a joint of the arm
        assert joint.mimic is not None
        position = joint.mimic.multiplier * at[joint.mimic.joint] + joint.mimic.offset
    along = np.array(joint.axis) * position
    if joint.kind == "prismatic":
        return make_pose(along, Rotation.identity())
    return make_pose(np.zeros(3), Rotation.from_rotvec(along))


def solid(shape: Shape, pose: Array) -> fcl.CollisionObject:
    kinds = {"box": fcl.Box, "cylinder": fcl.Cylinder, "sphere": fcl.Sphere}
    placement = fcl.Transform(rotation(pose).as_matrix(), pose[:3])
    return fcl.CollisionObject(kinds[shape.kind](*shape.size), placement)


GRIPPER = {"fingers": ["wave", "grip"], "closed": 0.5, "open": 0.9, "effort": 5.0}


def test_reads_gripper_and_springs(tmp_path):
    spec = crane() | {"gripper": GRIPPER, "counterbalanced": ["swing"]}
    robot = read_robot(write(tmp_path, spec))
    assert robot.gripper is not None
    assert robot.gripper.fingers == ("wave", "grip")
    assert (robot.gripper.closed, robot.gripper.open, robot.gripper.effort) == (0.5, 0.9, 5.0)
    assert robot.counterbalanced == {"swing"}


@pytest.mark.parametrize("robot", SHIPPED.values(), ids=SHIPPED)
def test_every_robot_has_a_gripper(robot):
    assert robot.gripper is not None
    for finger in robot.gripper.fingers:
        assert finger in robot.fixed_joints


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"fingers": ["wave", "wavy"]}, "'gripper.fingers': there is no such joint"),
        ({"fingers": ["wave", "swing"]}, "'swing'"),
        ({"fingers": ["wave", "wave"]}, "'fingers' must name two joints"),
        ({"open": 1.5}, "1.5 is beyond the limits of wave, 0.5 to 1"),
        ({"open": 0.5}, "'closed' and 'open' must differ"),
        ({"effort": 0.0}, "effort"),
    ],
)
def test_refuses_a_gripper_that_cannot_be(tmp_path, change, message):
    spec = crane() | {"gripper": GRIPPER | change}
    with pytest.raises(KinfeasError, match=message):
        read_robot(write(tmp_path, spec))


def test_refuses_springs_at_other_joints(tmp_path):
    spec = crane() | {"counterbalanced": ["wave"]}
    with pytest.raises(KinfeasError, match="'counterbalanced': 'wave' is no joint of 'arm'"):
        read_robot(write(tmp_path, spec))


def test_a_joint_takes_its_child_along():
    joint = SHIPPED["hsr"].urdf.joints["arm_lift_joint"]
    np.testing.assert_allclose(joint.pose_at(0.2), [0.0, 0.0, 0.54, 0.0, 0.0, 0.0, 1.0])
    joint = SHIPPED["pr2"].urdf.joints["r_shoulder_pan_joint"]
    turned = joint.pose_at(np.pi / 2.0)
    np.testing.assert_allclose(turned[:3], joint.origin[:3])
    np.testing.assert_allclose(turned[3:], [0.0, 0.0, 0.5**0.5, 0.5**0.5])


def test_a_joint_carries_all_links_below_it():
    urdf = SHIPPED["pr2"].urdf
    below = urdf.below("r_gripper_l_finger_joint")
    assert below == {"r_gripper_l_finger_link", "r_gripper_l_finger_tip_link"}
