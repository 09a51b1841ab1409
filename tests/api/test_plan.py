from dataclasses import replace

import numpy as np
import pytest

import kinfeas
from kinfeas.api.plan import Plan
from kinfeas.core.errors import KinfeasError
from kinfeas.core.solids import Solids
from kinfeas.core.spatial import compose, distance, integrate, wrap
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolver
from kinfeas.kinematics.solids import collides
from kinfeas.plugins.replay import Replay
from kinfeas.robots.robot import joint_displacement

FIRST = np.array([1.0, 0.5, 0.8, 0.0, 0.0, 0.0, 1.0])
POST = np.array([[1.4, 1.3, 0, 0.1, 0.1, 0.0, 1.2, 0, 0, 0, 0]])


def line(*twist):
    """Return EE poses of 10 s at a constant twist."""
    return integrate(FIRST, np.array(twist) * np.arange(0.0, 10.05, 0.1)[:, np.newaxis], 1.0)


@pytest.fixture(scope="module", params=["tiago", "hsr"])  # differential and omnidirectional
def robot(request):
    return kinfeas.load_robot(request.param)


@pytest.fixture(scope="module")
def plan(robot):
    path = line(0.1, 0.0, 0.0, 0.0, 0.0, 0.05)
    return kinfeas.plan(robot.folder, path, solids=Solids.from_table(POST))


def test_plans_keep_to_the_path_the_limits_and_the_room(plan, robot):
    solver, seconds = IkSolver(robot), np.diff(plan.time)
    ee = compose(plan.base_pose, forward(solver.chain, plan.joint_positions))
    metres, radians = distance(ee, plan.ee_pose)
    tolerance = robot.pose_tolerance
    assert metres[1:].max() <= (1e-3 if tolerance is None else 5e-3)  # the base makes up for it
    assert metres[0] <= (1e-3 if tolerance is None else 0.025)
    assert radians.max() <= (1e-2 if tolerance is None else 0.21)
    np.testing.assert_allclose(plan.ee_pose[[0, -1], 0], [1.0, 2.0], atol=1e-6)
    turned = joint_displacement(robot, plan.joint_positions[:-1], plan.joint_positions[1:])
    assert (np.abs(turned) <= robot.max_joint_velocity * seconds[:, np.newaxis] * 1.001).all()
    driven = np.linalg.norm(np.diff(plan.base[:, :2], axis=0), axis=1)
    assert (driven <= robot.base.max_velocity * seconds * 1.001).all()
    assert (np.abs(np.diff(plan.base[:, 2])) <= robot.base.max_rotation * seconds * 1.001).all()
    solids = Solids.from_table(POST).repeated(len(plan.time))
    assert not collides(solver.collision, plan.joint_positions, plan.base_pose, solids).any()


@pytest.mark.parametrize(("yaw", "joints", "target"), [
    (1.17, [0.16, -1.66, -0.01, 0.36, -1.18], [-2.271, 2.659, 1.136, 0.051, -0.893, -0.428, 0.13]),
    (-2.72, [0.69, -1.56, 0.51, -0.18, 1.42], [-1.644, 0.468, 0.485, -0.918, -0.267, 0.185, 0.228]),
    (1.11, [0.53, -1.71, 0.4, -0.06, -1.5], [1.254, 1.888, 1.182, -0.032, -0.621, -0.178, 0.762]),
])  # fmt: skip
def test_arms_of_five_joints_do_not_jump_where_no_base_pose_is_exact(hsr, yaw, joints, target):
    target = np.array(target) / np.append(np.ones(3), np.full(4, np.linalg.norm(target[3:])))
    plan = kinfeas.plan(hsr, "linear", target=target, start=(0.0, 0.0, yaw), joints=joints)
    metres, radians = distance(plan.reached, plan.ee_pose)
    assert metres.max() < 0.03
    assert radians.max() < 0.25
    assert np.diff(plan.time).max() < 0.2


def test_another_search_finds_a_path_where_the_first_one_has_a_jump():
    target = [-0.545, 0.728, 0.832, -0.623, 0.128, 0.505, 0.584]
    plan = kinfeas.plan("ridgeback_ur5", "linear", target=target, start=(0.0, 0.0, -0.76))
    assert distance(plan.reached, plan.ee_pose)[0].max() < 1e-3
    assert np.diff(plan.time).max() < 0.2


def test_the_ee_is_slower_where_the_robot_cannot_follow():
    poses = FIRST * np.ones((2, 1))
    poses[1, 0] += 0.3
    plan = kinfeas.plan("hsr", poses, step=5.0, start=(0.0, 0.0, 0.0))
    assert plan.time[-1] > 15.0  # in place of 5 s to the first pose, and 5 s from there
    np.testing.assert_allclose(plan.base[0], 0.0, atol=1e-9)
    np.testing.assert_allclose(plan.ee_pose[-1], poses[1], atol=1e-9)


def test_a_file_has_the_whole_plan(plan, robot, tmp_path):
    plan.save(tmp_path / "plan.csv")
    with pytest.raises(KinfeasError, match=r"plan\.csv: exists"):
        plan.save(tmp_path / "plan.csv")
    loaded = kinfeas.load_plan(tmp_path / "plan.csv", robot.folder)
    for name in ("time", "base", "joint_positions", "ee_pose"):
        np.testing.assert_allclose(getattr(loaded, name), getattr(plan, name), atol=1e-6)
    Replay(file=str(tmp_path / "plan.csv"), frame="world")
    trajectory, path = plan.joint_trajectory(), plan.base_path()
    assert trajectory["joint_names"] == [joint.name for joint in robot.arm]
    last = trajectory["points"][-1]["time_from_start"]
    assert last["sec"] + 1e-9 * last["nanosec"] == pytest.approx(plan.time[-1])
    assert len(trajectory["points"]) == len(path["poses"]) == len(plan.time)
    other = "tiago" if robot.name != "tiago" else "hsr"
    with pytest.raises(KinfeasError, match=r"plan.csv.*joint"):
        kinfeas.load_plan(tmp_path / "plan.csv", other)


def test_joints_may_have_the_names_of_other_columns(plan, robot, tmp_path):
    for file in ("robot.yaml", "robot.urdf"):
        text = (robot.folder / file).read_text()
        (tmp_path / file).write_text(text.replace(robot.arm[0].name, "yaw"))
    replace(plan, robot=kinfeas.load_robot(tmp_path)).save(tmp_path / "plan.csv")
    loaded = kinfeas.load_plan(tmp_path / "plan.csv", tmp_path)
    np.testing.assert_allclose(loaded.joint_positions, plan.joint_positions, atol=1e-6)
    np.testing.assert_allclose(loaded.base, plan.base, atol=1e-6)


@pytest.mark.parametrize(("change", "message"), [
    (("base", 0, 1.0), "row 51: 'x' exceeds"),
    (("base", 1, np.nan), "row 51: 'y' is beyond"),
    (("joint_positions", 0, 9.0), "row 51.*joint' is beyond"),
    (("ee_pose", 2, 0.5), "row 51.*EE pose"),
])  # fmt: skip
def test_plans_beyond_the_robot_are_errors(plan, robot, tmp_path, change, message):
    name, column, offset = change
    values = getattr(plan, name).copy()
    values[50:, column] += offset
    replace(plan, **{name: values}).save(tmp_path / "plan.csv")
    with pytest.raises(KinfeasError, match=message):
        kinfeas.load_plan(tmp_path / "plan.csv", robot.folder)


@pytest.mark.parametrize(("name", "direction", "message"), [
    ("hsr", (0.9, 0.9), "row 2: 'x' exceeds"), ("hsr", (0.6, 0.6), ""), ("tiago", (0.9, 0.0), ""),
    ("tiago", (0.0, 0.9), "row 2: 'x' moves the base sideways"),
])  # fmt: skip
def test_bases_of_plans_keep_their_planar_velocity_and_their_drive(
    name, direction, message, tmp_path
):
    robot, time = kinfeas.load_robot(name), np.arange(0.0, 2.0, 0.1)
    base = robot.base.max_velocity * time[:, np.newaxis] * [*direction, 0.0]
    joints = np.tile(robot.home["home"], (len(time), 1))
    plan = Plan(time, base, joints, np.empty((len(time), 7)), robot)
    replace(plan, ee_pose=plan.reached).save(tmp_path / "plan.csv")
    if not message:
        kinfeas.load_plan(tmp_path / "plan.csv", name)
        return
    with pytest.raises(KinfeasError, match=message):
        kinfeas.load_plan(tmp_path / "plan.csv", name)


def test_angles_in_files_may_be_within_one_turn(tmp_path):
    robot, time = kinfeas.load_robot("pr2"), np.arange(0.0, 10.0, 0.1)
    turns = wrap(3.0 + 0.1 * time)
    base, joints = np.zeros((len(time), 3)), np.tile(robot.home["home"], (len(time), 1))
    base[:, 2], joints[:, -1] = turns, turns
    plan = Plan(time, base, joints, np.empty((len(time), 7)), robot)
    replace(plan, ee_pose=plan.reached).save(tmp_path / "plan.csv")
    loaded = kinfeas.load_plan(tmp_path / "plan.csv", "pr2")
    for angle in (loaded.base[:, 2], loaded.joint_positions[:, -1]):
        np.testing.assert_allclose(angle, 3.0 + 0.1 * time, atol=1e-6)


def test_long_motions_and_other_files_are_errors(tmp_path):
    path = tmp_path / "ee.csv"
    path.write_text("x,y,z,qx,qy,qz,qw\n1,0,0.8,0,0,0,1\n41,0,0.8,0,0,0,1\n")
    with pytest.raises(KinfeasError, match=r"ee\.csv.*300 s"):
        kinfeas.plan("hsr", path)
    with pytest.raises(KinfeasError, match="'file'"):
        kinfeas.plan("hsr", path, settings={"file": "other.csv"})
    for name, value in {"target": FIRST, "step": 0.2}.items():
        with pytest.raises(KinfeasError, match=f"'{name}'"):
            kinfeas.plan("hsr", path, **{name: value})
    with pytest.raises(KinfeasError, match="2 poses"):
        kinfeas.plan("hsr", [FIRST])
    with pytest.raises(KinfeasError, match="'start'"):
        kinfeas.plan("hsr", path, joints=[0.0] * 5)
    with pytest.raises(KinfeasError, match=r"'joints': .*joint must be in \["):
        kinfeas.plan("hsr", [FIRST, FIRST], start=(0.0, 0.0, 0.0), joints=[9.0] * 5)


def test_plans_begin_where_the_robot_is(hsr):
    at_home = kinfeas.plan(
        "hsr", "kinfeas.plugins.linear:Linear", target=FIRST, start=(0.0, 0.0, 0.0)
    )
    np.testing.assert_allclose(at_home.base[0], 0.0, atol=1e-9)
    np.testing.assert_allclose(at_home.joint_positions[0], hsr.home["home"], atol=1e-3)
    np.testing.assert_allclose(at_home.ee_pose[-1], FIRST, atol=1e-4)
    path = line(0.1, 0, 0, 0, 0, 0)
    moved = kinfeas.plan("hsr", path, start=(-1.0, 0.0, 0.0))
    np.testing.assert_allclose(moved.base[0], [-1.0, 0.0, 0.0], atol=1e-9)
    assert distance(moved.ee_pose, path[0])[0].min() < 1e-6
    turn = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.1])
    path = integrate(at_home.ee_pose[0], turn * np.arange(2.0, 10.0)[:, np.newaxis], 1.0)
    turned = kinfeas.plan("hsr", path, step=1.0, start=(0.0, 0.0, 0.0))
    np.testing.assert_allclose(turned.joint_positions[0], hsr.home["home"], atol=1e-3)


def test_an_ee_that_rests_leaves_the_robot_where_it_is():
    start = [1.26, -0.635, -2.739]
    joints = [-1.57, 1.173, -0.2736, -0.4887, 2.0948, -1.9979, -0.7927]  # near a limit, to move off
    pose = [1.0, 0.0, 0.2283, 0.0, 0.0, 0.0, 1.0]
    plan = kinfeas.plan("pr2", [pose] * 30, start=start, joints=joints)
    np.testing.assert_allclose(plan.base[0], start, atol=1e-6)
    np.testing.assert_allclose(plan.joint_positions[0], joints, atol=0.01)
    assert np.abs(np.diff(plan.base, axis=0)).max() < 0.1


def test_turns_take_their_time_and_end_at_their_end(tmp_path):
    path = tmp_path / "ee.csv"
    path.write_text("time,x,y,z,qx,qy,qz,qw\n0,1,0,0.9,0,0,0,1\n20,1,0,0.9,0,0,0.6,0.8\n")
    plan = kinfeas.plan("pr2", path)
    np.testing.assert_allclose(plan.ee_pose[-1], [1, 0, 0.9, 0, 0, 0.6, 0.8], atol=1e-6)
    assert plan.time[-1] == pytest.approx(20.0, abs=0.3)


def test_poses_far_apart_have_moments_between_them():
    path = line(0.1, 0.0, 0.0, 0.0, 0.0, 0.05)[::50]
    plan = kinfeas.plan("tiago", path, step=5.0)
    assert np.diff(plan.time).max() < 0.3
    np.testing.assert_allclose(np.cross(plan.ee_pose[:, :3] - FIRST[:3], [1, 0, 0]), 0, atol=1e-6)
    turn = plan.base[:-1, 2] + np.diff(plan.base[:, 2]) / 2.0
    aside = np.cos(turn) * np.diff(plan.base[:, 1]) - np.sin(turn) * np.diff(plan.base[:, 0])
    assert np.abs(aside).sum() < 0.02


def test_poses_faster_than_the_base_take_longer(hsr):
    ends = [[1.0, 0.0, 0.8, 0.0, 0.0, 0.0, 1.0], [4.0, 0.0, 0.8, 0.0, 0.0, 0.0, 1.0]]
    plan = kinfeas.plan("hsr", ends)
    np.testing.assert_allclose(plan.ee_pose[[0, -1]], ends, atol=1e-9)
    assert plan.time[-1] >= 3.0 / hsr.base.max_velocity
    with pytest.raises(KinfeasError, match="settings"):
        kinfeas.plan("hsr", ends, settings={"max_velocity": 0.2})


def test_the_error_names_the_pose_out_of_reach_and_the_reason():
    with pytest.raises(KinfeasError, match=r"EE at 1, 0.5, 1.\d+ m after .* heights"):
        kinfeas.plan("hsr", line(0, 0, 0.2, 0, 0, 0)[25:50])
    post = Solids.from_table(np.array([[1.5, 0.5, 0, 0.1, 0.1, 0.0, 1.2, 0, 0, 0, 0]]))
    with pytest.raises(KinfeasError, match=r"in the way of base or arm: solid 0"):
        kinfeas.plan("hsr", line(0.1, 0, 0, 0, 0, 0)[30:60], solids=post)
    here = Solids.from_table(np.array([[0.0, 0.0, 0, 0.1, 0.1, 0.0, 0.3, 0, 0, 0, 0]]))
    with pytest.raises(KinfeasError, match="at the start base or arm touches solid 0"):
        kinfeas.plan("hsr", "linear", target=FIRST, start=(0.0, 0.0, 0.0), solids=here)


def test_the_reason_is_that_of_solids_where_they_have_moved():
    leaves = [1.4, 0.5, 0, 0.2, 0.2, 0.4, 1.2, 0, 0, 1, 99]
    stays = [2.0, 0.5, 0, 0.2, 0.2, 0.4, 1.2, 0, 0, 0, 0]
    with pytest.raises(KinfeasError, match=r"after 7.8 s: .*: solid 1"):
        kinfeas.plan("hsr", line(0.1, 0, 0, 0, 0, 0), solids=[leaves, stays])
