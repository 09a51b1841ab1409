import numpy as np
import pytest

from kinfeas.backends.pybullet.backend import PyBulletBackend
from kinfeas.control.execution import SubgoalMotion
from kinfeas.control.loop import Loop
from kinfeas.core import registry, spatial
from kinfeas.core.errors import KinfeasError
from kinfeas.core.start import Start
from kinfeas.kinematics.forward import forward
from kinfeas.plugins.linear import Linear
from kinfeas.robots.loading import load_robot
from tests.backends.pybullet.conftest import stay, twist

DT = 0.02


def random_joints(solver, rng):
    """Return joint positions that hold the EE above the floor."""
    while True:
        lower = np.array([max(joint.lower, -np.pi) for joint in solver.robot.arm])
        upper = np.array([min(joint.upper, np.pi) for joint in solver.robot.arm])
        joints = rng.uniform(lower, upper)
        if forward(solver.chain, joints)[2] > 0.4:
            return joints


def ee_pose(solver, state):
    return spatial.compose(state.base_pose, forward(solver.chain, state.joint_positions))


def test_reset_measures_what_it_was_told(world, begin):
    state = begin(x=1.0, y=-0.5, yaw=2.0)
    np.testing.assert_allclose(
        state.base_pose, spatial.planar_pose(*np.array([[1.0], [-0.5], [2.0]])), atol=1e-12
    )
    np.testing.assert_array_equal(state.joint_positions[0], world.sims[0].body.robot.home["home"])
    assert np.all(state.base_twist == 0.0)
    assert np.all(state.joint_velocities == 0.0)


def test_the_hand_is_where_our_kinematics_say(world, begin, solver):
    rng = np.random.default_rng(0)
    for _ in range(20):
        begin(*rng.uniform(-1.5, 1.5, 3), joints=random_joints(solver, rng))
        (state,) = stay(world, 1, twist(0.2, 0.1, 0.3))
        link = world.sims[0].body.links[solver.robot.ee_frame]
        measured = world.sims[0].physics.link_pose(world.sims[0].body.body, link)[np.newaxis]
        metres, radians = spatial.distance(ee_pose(solver, state), measured)
        assert metres[0] <= 1e-6
        assert radians[0] <= 1e-6


def test_the_arm_stands_firm_against_gravity(world, begin, solver):
    rng = np.random.default_rng(1)
    for _ in range(20):
        joints = random_joints(solver, rng)
        before = ee_pose(solver, begin(joints=joints))
        for _ in range(25):
            state = world.step(twist(), joints[np.newaxis], DT)
        if world.sims[0].contacts().arm == frozenset():
            assert spatial.distance(before, ee_pose(solver, state))[0][0] <= 1e-3


def test_the_hand_keeps_up_with_a_motion(world, begin, exact_solver):
    solver = exact_solver
    state = begin()
    desired = ee_pose(solver, state)
    reach = DT * solver.robot.max_joint_velocity
    for _ in range(100):
        desired = spatial.integrate(desired, np.array([[0.0, 0.0, 0.1, 0.0, 0.0, 0.0]]), DT)
        target = spatial.relative(desired, state.base_pose)
        arm = solver.solve(target, state.joint_positions, reach)
        assert arm.feasible.all()
        state = world.step(twist(), arm.joint_positions, DT)
        assert spatial.distance(desired, ee_pose(solver, state))[0][0] <= 0.006
    for _ in range(20):
        state = world.step(twist(), arm.joint_positions, DT)
    assert spatial.distance(desired, ee_pose(solver, state))[0][0] <= 1e-3


def test_joints_that_turn_on_and_on_are_measured_within_a_turn(world, begin):
    state, continuous = begin(), world.sims[0].body.robot.continuous
    for _ in range(150):
        targets = state.joint_positions + 0.05 * continuous
        state = world.step(twist(), targets, DT)
        measured = state.joint_positions[0, continuous]
        assert (np.abs(measured) <= np.pi).all()


def test_nothing_is_teleported(world, begin):
    robot, before, step = world.sims[0].body.robot, begin(), 1 / 240
    rng = np.random.default_rng(2)
    lower = np.array([max(joint.lower, -1.5) for joint in robot.arm])
    upper = np.array([min(joint.upper, 1.5) for joint in robot.arm])
    for tick in range(300):
        if tick % 50 == 0:
            target, command = rng.uniform(lower, upper)[np.newaxis], rng.uniform(-0.2, 0.2, 3)
        after = world.step(twist(*command), target, step)
        moved = spatial.integrate(before.base_pose, after.base_twist, step)
        np.testing.assert_allclose(after.base_pose, moved, atol=1e-9)
        joints = before.joint_positions + step * after.joint_velocities
        np.testing.assert_allclose(after.joint_positions, joints, atol=1e-9)
        before = after


def play(world, begin, seed):
    """Return all that is measured of an episode in which the robot pushes a bar about."""
    rng = np.random.default_rng(seed)
    robot = world.sims[0].body.robot
    begin(bar=np.array([0.6, *rng.uniform(-0.1, 0.1, 1), 0.05, 0.0, 0.0, 0.0, 1.0]))
    home, seen, touched = robot.home["home"][np.newaxis], [], 0
    world.sims[0].gripper.close()
    for _ in range(150):
        state = world.step(twist(0.2, 0.0, rng.uniform(-0.2, 0.2)), home, DT)
        measured = (state.base_pose, state.joint_positions, state.joint_velocities)
        bar = world.sims[0].furniture.link_pose("bar", "bar")
        seen.append(np.concatenate([bar, *(one.ravel() for one in measured)]))
        touched += len(world.sims[0].contacts().base)
    assert touched > 0
    return np.array(seen)


def test_equal_episodes_are_equal_to_the_bit_whatever_was_before(
    robot, scene, solver, world, begin, between_fingers
):
    rng = np.random.default_rng(0)
    for _ in range(20):  # at times within a wall
        begin(*rng.uniform(-1.5, 1.5, 3), joints=random_joints(solver, rng))
        stay(world, 1, twist(0.2, 0.1, 0.3))
    begin(bar=between_fingers)
    world.sims[0].gripper.close()
    for _ in range(40):
        stay(world, 1)
        if world.sims[0].grasp.held is None:
            world.sims[0].grasp.hold(*world.sims[0].furniture.link("bar", "bar"))
    play(world, begin, 5)
    stay(world, 2, dt=0.1)
    later = play(world, begin, 7)
    fresh = PyBulletBackend(robot, scene)

    def reset(**poses):
        fresh.sims[0].furniture.furnish(scene.with_poses(poses))
        home = robot.home["home"][np.newaxis]
        fresh.reset(spatial.planar_pose(*np.zeros((3, 1))), home)

    first = play(fresh, reset, 7)
    fresh.close()
    np.testing.assert_array_equal(later, first)


def test_a_row_begins_anew_while_the_others_go_on(robot, scene):
    world, home = PyBulletBackend(robot, scene), robot.home["home"]
    places = spatial.planar_pose(np.arange(3.0), np.zeros(3), np.zeros(3))
    homes = np.stack([home] * 3)
    world.reset(places, homes)
    for _ in range(5):
        before = world.step(np.repeat(twist(0.2), 3, axis=0), homes, DT)
    after = world.reset(places[1:2], homes[1:2], np.array([1]))
    world.close()
    np.testing.assert_array_equal(after.base_pose[[0, 2]], before.base_pose[[0, 2]])
    np.testing.assert_allclose(after.base_pose[1], places[1], atol=1e-12)
    assert np.all(before.base_pose[:, 0] > places[:, 0])


def test_worlds_do_not_know_of_each_other(robot, world, begin):
    begin()
    alone = stay(world, 10, twist(0.2))[-1]
    other = PyBulletBackend(robot)
    begin()
    other.reset(spatial.planar_pose(*np.ones((3, 1))), robot.home["home"][np.newaxis])
    for _ in range(10):
        (state,) = stay(world, 1, twist(0.2))
        other.step(twist(-0.2), robot.home["home"][np.newaxis], DT)
    other.close()
    np.testing.assert_array_equal(state.base_pose, alone.base_pose)


def test_runs_in_the_loop(world, begin, solver):
    begin()
    robot = solver.robot
    base = spatial.planar_pose(*np.zeros((3, 1)))
    home = robot.home["home"][np.newaxis]
    goal = spatial.compose(base, forward(solver.chain, home))
    goal[0, 2] += 0.05
    loop = Loop(solver, [SubgoalMotion(Linear())], world, DT)
    loop.start(Start(base, home, goal[:, np.newaxis]), [np.random.default_rng(0)])
    action = np.zeros((1, 3 if robot.base.drive == "omnidirectional" else 2))
    for _ in range(1500):
        step = loop.step(action)
        assert step.feasible[0]
        assert step.deviation[0] <= 0.01
        if step.finished[0]:
            break
    assert step.finished[0]


def test_is_found_by_its_name(robot):
    backend = registry.build("kinfeas.backends", "pybullet", {"robot": robot})
    assert isinstance(backend, PyBulletBackend)
    backend.close()
    backend.close()


def test_refuses_what_it_cannot_do(world, begin):
    begin()
    home = world.sims[0].body.robot.home["home"]
    base = spatial.planar_pose(*np.zeros((3, 2)))
    with pytest.raises(KinfeasError, match="arm joints"):
        world.reset(base, home[np.newaxis])
    with pytest.raises(KinfeasError, match="arm joints"):
        world.step(twist(), home[np.newaxis, :-1], DT)
    with pytest.raises(KinfeasError, match="must be finite numbers"):
        world.step(twist(np.nan), home[np.newaxis], DT)
    base[:, 2] = 0.1
    with pytest.raises(KinfeasError, match="the base must stand upright on the floor"):
        world.reset(base[:1], home[np.newaxis])


def test_a_world_that_is_gone_is_one_sentence():
    robot = load_robot("hsr")
    world, home = PyBulletBackend(robot), robot.home["home"][np.newaxis]
    world.reset(np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]]), home)
    world.close()
    with pytest.raises(KinfeasError, match="its window was closed: Not connected"):
        world.step(np.zeros((1, 6)), home, 0.02)
