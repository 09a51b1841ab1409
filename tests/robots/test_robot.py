import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from kinfeas.config import registry
from kinfeas.core.errors import KinfeasError
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolver
from kinfeas.robots.loading import load_robot
from kinfeas.robots.robot import exceeds_joint_velocity, fingerprint, joint_displacement

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
        "name": "crane", "ee_frame": "hook", "tool_tip": [0.1, 0, 0],
        "gripper_rotation": [0, 0, 0.7071, 0.7071],
        "base": {
            "drive": "differential", "max_velocity": 0.2, "max_rotation": 1,
            "max_acceleration": 1, "max_rotation_acceleration": 2,
        },
        "arm": {"lift": {}, "swing": {"velocity": 0.5}, "spin": {"velocity": 3}},
        "home": {"home": [0.5, 0.0, 9.0], "low": [0.2, 1.5, 0.0]},
        "reach": {"low": 0.2, "high": 1.2},
    }  # fmt: skip


def write(folder: Path, spec: dict, urdf: str = URDF) -> Path:
    (folder / "robot.urdf").write_text(urdf)
    (folder / "robot.yaml").write_text(yaml.safe_dump(spec, sort_keys=False))
    return folder


GRIPPER = {"fingers": ["wave", "grip"], "closed": 0.5, "open": 0.9, "effort": 5.0}


def test_each_finger_may_have_its_own_positions(tmp_path):
    spec = crane() | {"gripper": GRIPPER | {"open": [0.9, -0.3]}}
    gripper = load_robot(write(tmp_path, spec)).gripper
    assert gripper.positions("close") == {"wave": 0.5, "grip": 0.5}
    assert gripper.positions("open") == {"wave": 0.9, "grip": -0.3}
    assert gripper.ratio == pytest.approx(-2.0)


def test_the_working_folder_may_be_that_of_a_robot(tmp_path, monkeypatch):
    write(tmp_path, crane())
    monkeypatch.chdir(tmp_path)
    assert load_robot(".").name == "crane"


def test_arm_limits_are_read_only_arrays(tmp_path):
    robot = load_robot(write(tmp_path, crane()))
    for found, values in (
        (robot.continuous, [False, False, True]),
        (robot.max_joint_velocity, [0.1, 0.5, 3.0]),
        (robot.joint_limits[0], [0.2, -1.5, -math.inf]),
        (robot.joint_limits[1], [1.0, 1.5, math.inf]),
        (robot.finite_joint_limits[0], [0.2, -1.5, -math.pi]),
        (robot.finite_joint_limits[1], [1.0, 1.5, math.pi]),
    ):
        np.testing.assert_array_equal(found, values, strict=True)
        assert not found.flags.writeable


@pytest.mark.parametrize(("kind", "multiplier", "periodic"), [
    ("revolute", 2, True), ("revolute", 0.5, False), ("prismatic", 1, False),
])  # fmt: skip
def test_a_turn_of_a_continuous_joint_brings_its_followers_back(
    tmp_path, kind, multiplier, periodic
):
    urdf = URDF.replace('name="grip" type="revolute"', f'name="grip" type="{kind}"')
    mimic = f'<mimic joint="spin" multiplier="{multiplier}"/>'
    spec = crane() | {"home": {"home": [0.5, 0.0, 1.0]}}
    robot = load_robot(write(tmp_path, spec, urdf.replace('<mimic joint="swing"/>', mimic)))
    # Otherwise the joint has one turn, since positions a turn apart count as equal.
    assert robot.arm[-1].continuous == periodic
    assert robot.arm[-1].upper == (math.inf if periodic else math.pi)


WITHOUT_SWING = {"arm": {"lift": {}, "spin": {"velocity": 3}}, "home": {"home": [0.5, 0.0]}}


@pytest.mark.parametrize(("changes", "positions"), [
    ({}, {"wave": 0.5, "ring": 1.1}),  # as near to 0 as the limits allow
    ({"fixed_joints": {"wave": 0.7}}, {"wave": 0.7, "ring": 1.5}),
    (WITHOUT_SWING | {"fixed_joints": {"swing": 0.3}},
     {"swing": 0.3, "wave": 0.5, "ring": 1.1, "grip": 0.3}),
])  # fmt: skip
def test_other_joints_are_fixed_or_mimic(tmp_path, changes, positions):
    assert load_robot(write(tmp_path, crane() | changes)).fixed_joints == pytest.approx(positions)


ARM = crane()["arm"]


@pytest.mark.parametrize(("changes", "where"), [
    ({"tool_tip": [0.1, 0.0, math.nan]}, "'tool_tip.2'"),
    ({"ee_frame": "hok"}, "'ee_frame'.*'hook'"),
    ({"arm": {"lfit": {}}}, "'arm.lfit'.*'lift'"),
    ({"arm": {"lift": {}, "wave": {}}}, "'arm'"),
    ({"arm": ARM | {"spin": {}}}, "'arm.spin'.*'velocity'"),
    ({"arm": ARM | {"swing": {"soft_limits": [-3, 1]}}}, "'arm.swing'.*-3"),
    (WITHOUT_SWING, "'swing'"),
    ({"reach": {"low": 1.2, "high": 0.2}}, "'reach'.*'low'"),
    ({"fixed_joints": {"lift": 0.5}}, "'fixed_joints.lift'"),
    ({"fixed_joints": {"wave": 0.1}}, "'fixed_joints.wave'"),
    ({"ignored_collisions": [["mast", "sea"]]}, "'ignored_collisions'.*'sea'"),
    ({"gripper": GRIPPER | {"fingers": ["wave", "swing"]}}, "'gripper.fingers'"),
    ({"gripper": GRIPPER | {"open": [0.9, 9.5]}}, "'gripper.open', grip"),
    ({"counterbalanced": ["wave"]}, "'counterbalanced'.*'wave'"),
])  # fmt: skip
def test_a_broken_robot_is_an_error_with_its_key(tmp_path, changes, where):
    with pytest.raises(KinfeasError, match=f"^{tmp_path}.*{where}"):
        load_robot(write(tmp_path, crane() | changes))


def test_displacements_take_the_short_way_and_jumps_exceed_the_velocity(tmp_path):
    robot = load_robot(write(tmp_path, crane()))
    before = np.array([0.5, 0.0, math.pi - 0.01])
    after = np.array([0.5, 0.05, -math.pi + 0.01])
    np.testing.assert_allclose(joint_displacement(robot, before, after), [0.0, 0.05, 0.02])
    assert not exceeds_joint_velocity(robot, before, after, 0.1)  # just at the limit of 0.5 rad/s
    assert exceeds_joint_velocity(robot, before, after, 0.099)


@pytest.mark.parametrize("name", registry.names("kinfeas.robots"))
def test_a_shipped_robot_is_a_folder_with_its_licence(name):
    robot = load_robot(name)
    assert registry.build("kinfeas.robots", name, {}) == robot.folder
    assert (robot.name, robot.folder.name) == (name, name)
    head = (robot.folder / "robot.yaml").read_text().partition("name: ")[0]
    assert registry.load("kinfeas.robots", name).__doc__ == head.splitlines()[0].removeprefix("# ")
    assert "licence" in head
    solver, home = IkSolver(robot), robot.home["home"][np.newaxis]
    assert solver.solve(forward(solver.chain, home), home).feasible.all()


def test_the_shipped_gripper_axes_follow_the_convention(robot):
    turn = Rotation.from_quat(robot.gripper_rotation).inv()
    length = np.linalg.norm(robot.tool_tip)
    np.testing.assert_allclose(turn.apply(robot.tool_tip), [length, 0, 0], atol=1e-12)
    fingers = {"pr2": [0, 1, 0], "tiago": [0, 0, 1], "hsr": [0, 1, 0]}  # in the EE frame
    np.testing.assert_allclose(np.abs(turn.apply(fingers[robot.name])), [0, 1, 0], atol=1e-12)


# Policies of another fingerprint raise an error, so these change only with the robot.
KNOWN = {
    "pr2": "sha256:4cc5c688f1cf919bdf0619051a89089c00006cbffbd35df32d6c6c326eb794ec",
    "tiago": "sha256:b4ed2eee5e8e022bb02865c7c820859c62ee2397c170c7c072d3519558b00d30",
    "hsr": "sha256:619dc04fe5826c6529f7ae8bc1c879dfee07299e4eab23793e96400f10ba315c",
}


def test_the_fingerprint_is_stable(robot):
    assert fingerprint(robot) == KNOWN[robot.name]


def with_joint(robot, name, **changes):
    joints = dict(robot.urdf.joints)
    joints[name] = replace(joints[name], **changes)
    return replace(robot, urdf=replace(robot.urdf, joints=joints))


def with_arm(robot, **changes):
    return replace(robot, arm=(replace(robot.arm[0], **changes), *robot.arm[1:]))


def moved(robot, name, metres):
    origin = robot.urdf.joints[name].origin.copy()
    origin[2] += metres
    return with_joint(robot, name, origin=origin)


OTHER = {
    "velocity": lambda r: replace(r, base=replace(r.base, max_velocity=0.3)),
    "drive": lambda r: replace(r, base=replace(r.base, drive="differential")),
    "soft limit": lambda r: with_arm(r, lower=r.arm[0].lower + 1e-3),
    "fewer joints": lambda r: replace(
        r, arm=r.arm[:-1], fixed_joints={**r.fixed_joints, r.arm[-1].name: 0.0}
    ),
    "torso": lambda r: replace(r, fixed_joints={**r.fixed_joints, "torso_lift_joint": 0.2}),
    "link length": lambda r: moved(r, "r_elbow_flex_joint", 1e-5),
    "EE frame": lambda r: replace(r, ee_frame="r_gripper_palm_link"),
}

SAME = {
    "acceleration": lambda r: replace(r, base=replace(r.base, max_acceleration=0.1)),
    "joint velocity": lambda r: with_arm(r, velocity=0.1),
    "tool tip": lambda r: replace(r, tool_tip=np.zeros(3)),
    "left arm": lambda r: moved(r, "l_elbow_flex_joint", 0.1),
    "rounding": lambda r: moved(r, "r_elbow_flex_joint", 1e-13),
}


@pytest.mark.parametrize("change", [*OTHER, *SAME])
def test_only_other_kinematics_have_another_fingerprint(pr2, change):
    changed = (OTHER | SAME)[change](pr2)
    assert (fingerprint(changed) == fingerprint(pr2)) == (change in SAME)


@pytest.mark.parametrize("name", registry.names("kinfeas.robots"))
def test_other_programs_read_shipped_robots(name):
    assert pytest.importorskip("pinocchio").buildModelFromUrdf(str(load_robot(name).urdf_path)).nq
