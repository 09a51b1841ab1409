from pathlib import Path

import numpy as np
import pytest
import yaml

from kinfeas.backends.physics.visuals import ROBOT
from kinfeas.core import spatial
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkOptions, IkSolver
from kinfeas.robots.loading import load_robot
from tests.backends.conftest import place, stay
from tests.builders import assert_near, at, twist

DT = 0.02


def random_joints(solver, rng):
    lower, upper = (np.clip(limit, -np.pi, np.pi) for limit in solver.robot.joint_limits)
    while True:
        joints = rng.uniform(lower, upper)
        if forward(solver.chain, joints)[2] > 0.4:
            return joints


def ee_pose(solver, state):
    return spatial.compose(state.base_pose, forward(solver.chain, state.joint_positions))


def test_a_reset_is_measured(world, begin):
    state = begin(x=1.0, y=-0.5, yaw=2.0)
    np.testing.assert_allclose(state.base_pose, at(1.0, -0.5, 2.0), atol=1e-12)
    np.testing.assert_array_equal(state.joint_positions[0], world.robot.home["home"])
    assert np.all(state.base_twist == 0.0)
    assert np.all(state.joint_velocities == 0.0)


@pytest.mark.parametrize("name", ["pr2", "tiago", "hsr"])
def test_the_hand_agrees_with_the_kinematics_and_holds_its_position(name, opened):
    world = opened(load_robot(name))
    solver, rng = IkSolver(world.robot), np.random.default_rng(0)
    for _ in range(10):
        joints = random_joints(solver, rng)
        base = spatial.planar_pose(*rng.uniform(-1.5, 1.5, (3, 1)))
        before = ee_pose(solver, world.reset(base, joints[np.newaxis]))
        for _ in range(25):
            state = world.step(twist(), joints[np.newaxis], DT)
        measured = world.link_poses(0, [(ROBOT, solver.robot.ee_frame)])
        assert_near(ee_pose(solver, state), measured, 1e-6, 1e-6)
        if not world.contacts(0).arm:  # gravity does not move it
            assert spatial.distance(before, measured)[0][0] <= 1e-3


def test_the_hand_keeps_up_with_a_motion(world, begin):
    solver = IkSolver(world.robot, IkOptions(pose_tolerance=False))
    state = begin()
    desired, reach = ee_pose(solver, state), DT * solver.robot.max_joint_velocity
    for tick in range(120):
        speed = np.array([[0.0, 0.0, 0.1 * (tick < 100), 0.0, 0.0, 0.0]])
        desired = spatial.integrate(desired, speed, DT)
        arm = solver.solve(spatial.relative(desired, state.base_pose), state.joint_positions, reach)
        assert arm.feasible.all()
        state = world.step(twist(), arm.joint_positions, DT)
        assert spatial.distance(desired, ee_pose(solver, state))[0][0] <= 0.006
    assert spatial.distance(desired, ee_pose(solver, state))[0][0] <= 1e-3


def test_positions_are_the_integral_of_velocities(world, begin):
    before, step, rng = begin(), 1 / 240, np.random.default_rng(2)
    lower, upper = (np.clip(limit, -1.5, 1.5) for limit in world.robot.joint_limits)
    for tick in range(200):
        if tick % 50 == 0:
            target, command = rng.uniform(lower, upper)[np.newaxis], rng.uniform(-0.2, 0.2, 3)
        after = world.step(twist(*command), target, step)
        moved = spatial.integrate(before.base_pose, after.base_twist, step)
        np.testing.assert_allclose(after.base_pose, moved, atol=1e-9)
        joints = before.joint_positions + step * after.joint_velocities
        np.testing.assert_allclose(after.joint_positions, joints, atol=1e-9)
        before = after


def play(world, scene, seed):
    """Return all measurements of an episode in which the robot pushes and grasps a bar."""
    rng = np.random.default_rng(seed)
    bar = np.array([0.6, *rng.uniform(-0.1, 0.1, 1), 0.05, 0.0, 0.0, 0.0, 1.0])
    place(world, scene=scene.with_poses({"bar": bar}))
    world.grip("close", np.array([0]))
    seen, touched = [], 0
    for _ in range(150):
        (state,) = stay(world, 1, twist(0.2, 0.0, rng.uniform(-0.2, 0.2)))
        measured = (state.base_pose, state.joint_positions, state.joint_velocities)
        bar, _ = world.object_motion(0, "bar")
        seen.append(np.concatenate([bar, *(one.ravel() for one in measured)]))
        touched += len(world.contacts(0).base)
    assert touched > 0
    return np.array(seen)


def test_equal_episodes_are_equal_to_the_bit(hsr, scene, world, begin, opened):
    """Whatever happened before: contacts, another control period."""
    solver, rng = IkSolver(hsr), np.random.default_rng(0)
    for _ in range(20):  # sometimes inside a wall
        begin(*rng.uniform(-1.5, 1.5, 3), joints=random_joints(solver, rng))
        stay(world, 1, twist(0.2, 0.1, 0.3))
    play(world, scene, 5)
    stay(world, 2, dt=0.1)
    later = play(world, scene, 7)
    np.testing.assert_array_equal(later, play(opened(hsr, scene), scene, 7))


def test_one_row_is_reset_while_others_go_on(hsr, scene, opened):
    world, homes = opened(hsr, scene), np.stack([hsr.home["home"]] * 3)
    places = spatial.planar_pose(np.arange(3.0), np.zeros(3), np.zeros(3))
    world.reset(places, homes)
    for _ in range(5):
        before = world.step(np.repeat(twist(0.2), 3, axis=0), homes, DT)
    after = world.reset(places[1:2], homes[1:2], np.array([1]))
    np.testing.assert_array_equal(after.base_pose[[0, 2]], before.base_pose[[0, 2]])
    np.testing.assert_allclose(after.base_pose[1], places[1], atol=1e-12)
    assert np.all(before.base_pose[:, 0] > places[:, 0])


@pytest.mark.parametrize("right", [0.05, -0.05, -0.025])
def test_each_finger_goes_to_its_own_position(opened, tmp_path, right):
    scout = Path(__file__).parents[3] / "examples" / "own_robot"
    urdf = (scout / "robot.urdf").read_text()
    if right < 0.0:
        old = '<axis xyz="0 -1 0"/>\n    <limit lower="0" upper="0.05"'
        assert old in urdf
        urdf = urdf.replace(old, f'<axis xyz="0 1 0"/>\n    <limit lower="{right}" upper="0"')
    spec = yaml.safe_load((scout / "robot.yaml").read_text())
    spec["gripper"] |= {"closed": [0.0, 0.0], "open": [0.05, right]}
    spec["fixed_joints"] |= {"right_finger_joint": right / 2.0}
    (tmp_path / "robot.urdf").write_text(urdf)
    (tmp_path / "robot.yaml").write_text(yaml.safe_dump(spec, sort_keys=False))
    world = opened(load_robot(tmp_path))
    place(world)
    links = [(ROBOT, name) for name in ("wrist_roll_link", "left_finger_link", "right_finger_link")]
    for grip, opening in (("open", 1.0), ("close", 0.0)):
        world.grip(grip, np.arange(1))
        stay(world, 120)
        palm, *fingers = world.link_poses(0, links)
        sideways = [spatial.relative(finger, palm)[1] for finger in fingers]
        expected = [0.05 * opening, -abs(right) * opening]
        np.testing.assert_allclose(sideways, expected, atol=1e-3)
