"""Bases, arms and hands in physics: they follow their commands within their limits."""

from dataclasses import replace

import numpy as np
import pytest

from kinfeas.backends.physics.backend import ROBOT
from kinfeas.control.execution import tool_pose
from kinfeas.core import spatial
from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import compose
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkOptions, IkSolver
from kinfeas.robots.loading import load_robot
from tests.backends.conftest import place, stay
from tests.builders import assert_near, twist

DT, STEP = 0.02, 1 / 240


def random_joints(solver, rng):
    lower, upper = (np.clip(limit, -np.pi, np.pi) for limit in solver.robot.joint_limits)
    while True:
        joints = rng.uniform(lower, upper)
        if forward(solver.chain, joints)[2] > 0.4:
            return joints


def ee_pose(solver, state):
    return spatial.compose(state.base_pose, forward(solver.chain, state.joint_positions))


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
        if not world.touching(0).arm:  # gravity does not move it
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


def test_positions_are_the_integral_of_velocities_within_their_limits(world, begin):
    before, rng = begin(), np.random.default_rng(2)
    lower, upper = (np.clip(limit, -1.5, 1.5) for limit in world.robot.joint_limits)
    fastest = np.zeros(len(lower))
    for tick in range(400):
        if tick % 80 == 0:
            target, command = rng.uniform(lower, upper)[np.newaxis], rng.uniform(-0.2, 0.2, 3)
        after = world.step(twist(*command), target, STEP)
        moved = spatial.integrate(before.base_pose, after.base_twist, STEP)
        np.testing.assert_allclose(after.base_pose, moved, atol=1e-9)
        joints = before.joint_positions + STEP * after.joint_velocities
        np.testing.assert_allclose(after.joint_positions, joints, atol=1e-9)
        before, fastest = after, np.maximum(fastest, np.abs(after.joint_velocities[0]))
    after = world.step(twist(0.2), target, 1e-3)  # less than a step of an engine
    moved = spatial.integrate(before.base_pose, after.base_twist, 1e-3)
    np.testing.assert_allclose(after.base_pose, moved, atol=1e-9)
    for dt in (0.0, -0.02, np.nan, np.inf):
        with pytest.raises(KinfeasError, match="control period"):
            world.step(twist(), target, dt)
    fastest /= world.robot.max_joint_velocity
    assert np.all(fastest <= 1.05)
    assert np.any(fastest >= 0.9)


def play(world, scene, seed):
    """Return all measurements of an episode in which the robot pushes a bar."""
    rng = np.random.default_rng(seed)
    bar = np.array([0.6, *rng.uniform(-0.1, 0.1, 1), 0.05, 0.0, 0.0, 0.0, 1.0])
    place(world, scene=scene.with_poses({"bar": bar}))
    world.grip("close", np.array([0]))
    measured, touched = [], 0
    for _ in range(150):
        (state,) = stay(world, 1, twist(0.2, 0.0, rng.uniform(-0.2, 0.2)))
        values = (state.base_pose, state.joint_positions, state.joint_velocities)
        bar, _ = world.object_motion(0, "bar")
        measured.append(np.concatenate([bar, *(value.ravel() for value in values)]))
        touched += len(world.touching(0).base)
    assert touched > 0
    return np.array(measured)


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


@pytest.mark.parametrize("right", [0.05, -0.05, -0.025])
@pytest.mark.parametrize("velocity", [0.05, 0.0])  # 0 stands for none
def test_each_finger_goes_to_its_own_position(opened, scout, right, velocity):
    def mirrored(urdf):
        if right > 0.0:
            return urdf
        old = '<axis xyz="0 -1 0"/>\n    <limit lower="0" upper="0.05"'
        assert old in urdf
        return urdf.replace(old, f'<axis xyz="0 1 0"/>\n    <limit lower="{right}" upper="0"')

    settings = {
        "gripper": {"closed": [0.0, 0.0], "open": [0.05, right]},
        "fixed_joints": {"right_finger_joint": right / 2.0},
    }
    limits = 'velocity="0.05" effort', f'velocity="{velocity}" effort'
    world = opened(scout(lambda urdf: mirrored(urdf).replace(*limits), **settings))
    place(world)
    links = [(ROBOT, name) for name in ("wrist_roll_link", "left_finger_link", "right_finger_link")]
    for grip, opening in (("open", 1.0), ("close", 0.0)):
        world.grip(grip, np.arange(1))
        stay(world, 120)
        palm, *fingers = world.link_poses(0, links)
        sideways = [spatial.relative(finger, palm)[1] for finger in fingers]
        np.testing.assert_allclose(sideways, [0.05 * opening, -abs(right) * opening], atol=1e-3)


def test_a_continuous_joint_takes_the_shorter_path(opened):
    world = opened(load_robot("pr2"))
    home = world.robot.home["home"].copy()
    home[-1] = 3.0
    place(world, joints=home)
    home[-1] = -3.0
    states = [world.step(twist(), home[np.newaxis], DT) for _ in range(50)]
    angles = np.array([state.joint_positions[0, -1] for state in states])
    assert np.abs(angles).max() <= np.pi
    assert np.abs(angles).min() > 2.9
    assert angles[-1] == pytest.approx(-3.0, abs=1e-4)


def test_a_joint_without_effort_is_an_error(engine):
    robot = load_robot("tiago")
    joints = dict(robot.urdf.joints)
    joints["arm_3_joint"] = replace(joints["arm_3_joint"], effort=0.0)
    with pytest.raises(KinfeasError, match="'arm_3_joint'"):
        engine(replace(robot, urdf=replace(robot.urdf, joints=joints))).open()


@pytest.mark.parametrize("command", [twist(0.2), twist(0.2, 0.1, -0.4), twist(turn=0.4)])
def test_the_base_keeps_its_acceleration_limits(world, begin, command):
    begin()
    states = stay(world, 120, command, STEP) + stay(world, 120, twist(), STEP)
    speed = np.array([state.base_twist[0, [0, 1, 5]] for state in states])
    change = np.diff(speed, axis=0, prepend=0.0) / STEP
    base = world.robot.base
    assert np.hypot(change[:, 0], change[:, 1]).max() <= base.max_acceleration * 1.01
    assert np.abs(change[:, 2]).max() <= base.max_rotation_acceleration * 1.01
    np.testing.assert_allclose(states[119].base_twist, command, atol=1e-3)
    np.testing.assert_allclose(states[-1].base_twist, 0.0, atol=1e-3)


def test_a_differential_drive_moves_along_its_heading(opened):
    world, rng = opened(load_robot("tiago")), np.random.default_rng(0)
    place(world, yaw=0.7)
    for _ in range(100):
        x, y, rate = rng.uniform(-0.2, 0.2, 3)
        (state,) = stay(world, 1, twist(x, y, 2.0 * rate))
        heading = spatial.yaw(state.base_pose)[0]
        assert abs([-np.sin(heading), np.cos(heading)] @ state.base_twist[0, :2]) <= 1e-3
    place(world, yaw=0.7)  # it follows the part along its heading
    state = stay(world, 50, twist(0.1))[-1]
    assert np.linalg.norm(state.base_twist[0, :2]) == pytest.approx(0.1 * np.cos(0.7), abs=1e-3)


FIRST = np.array([0])
STILL = np.array([0.0, 0.0, 0.0, 1.0])


@pytest.fixture
def begun(hsr, scene, opened):
    """A function that puts a bar on the edge of a chest, in the open hand or beside its middle."""
    x, y, z = compose(forward(IkSolver(hsr).chain, hsr.home["home"]), tool_pose(hsr))[:3]
    chest = np.array([x + 0.22, y, z - 0.3, *STILL])

    def build(name="bar", aside=0.0, *, handled=True):
        world = opened(hsr, scene)
        if handled:
            world.handle(name, "bar")
        bar = np.array([x, y + aside, z, *STILL])
        place(world, scene=scene.with_poses({name: bar, "chest": chest}))
        return world

    return build


def bar_of(world):
    return world.object_motion(0, "bar")[0]


def test_a_grasp_carries_an_object_until_it_is_opened(begun):
    world = begun()
    assert not world.holds(0, "bar")
    world.grip("close", FIRST)
    stay(world, 60)
    assert world.holds(0, "bar")
    assert not (world.touching(0).arm or world.touching(0).base)  # the grasped link does not count
    before = bar_of(world)
    stay(world, 150, twist(-0.1))
    np.testing.assert_allclose(bar_of(world)[:3] - before[:3], [-0.29, 0.0, 0.0], atol=0.02)
    world.grip("open", FIRST)
    assert not world.holds(0, "bar")
    stay(world, 60)
    assert bar_of(world)[2] < 0.2


def test_a_grasp_breaks_above_its_limit(begun):
    world = begun("post")
    world.grip("close", FIRST)
    stay(world, 60)
    assert world.holds(0, "post")
    stay(world, 150, twist(-0.1))  # the post is fixed
    assert not world.holds(0, "post")


def test_a_grasp_needs_both_fingers(begun):
    world = begun(aside=0.5)
    world.grip("close", FIRST)
    stay(world, 60)
    assert not world.holds(0, "bar")
    # At the first of these positions that one finger touches, the other is far away.
    near = (
        aside for aside in np.arange(0.0, 0.1, 0.004) if begun(aside=aside, handled=False).touched()
    )
    world = begun(aside=next(near))
    world.grip("close", FIRST)
    stay(world, 1)
    assert not world.holds(0, "bar")
    stay(world, 60)
    assert world.holds(0, "bar")
