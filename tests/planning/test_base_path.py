from dataclasses import replace

import numpy as np
import pytest

from kinfeas.control.observation import HORIZON
from kinfeas.core.solids import Solids
from kinfeas.core.spatial import compose, integrate, planar_pose, relative, rotation
from kinfeas.kinematics.drive import base_twist
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolver
from kinfeas.kinematics.solids import base_collides, collides
from kinfeas.planning.base_path import BasePathPlanner
from kinfeas.planning.beam import BeamExpander
from kinfeas.robots.loading import load_robot
from kinfeas.robots.robot import joint_displacement
from tests.builders import assert_near

AT_ORIGIN = planar_pose(*np.zeros((3, 1)))[0]


@pytest.fixture(scope="module")
def solver(hsr):
    return IkSolver(hsr)


@pytest.fixture
def planned(solver):
    """Return the path of a robot at home along an EE motion of some twist, and its arm there."""
    robot = solver.robot
    joints = robot.home["home"]
    ee = forward(solver.chain, joints[np.newaxis])[0]

    def plan(twist, seconds=20.0, solids=None, clearance=0.0, **given):
        time = np.arange(0.0, seconds + 1e-6, HORIZON)[:, np.newaxis]
        poses = integrate(ee, np.array(twist) * time, 1.0)
        options = replace(solver.options, solid_clearance=clearance)
        planner = BasePathPlanner(IkSolver(robot, options))
        return planner.plan(AT_ORIGIN, joints, poses, HORIZON, 5.0, solids=solids, **given), joints

    return plan


def test_between_its_times_a_base_moves_on_an_arc(planned):
    path, _ = planned([0.05, 0.0, 0.0, 0.0, 0.0, 0.2])
    middle, last = path.robots_at(np.array([path.seconds[1:3].mean(), 1e3]))
    np.testing.assert_allclose(middle[3:], path.robot[1:3, 3:].mean(axis=0))
    np.testing.assert_allclose(last, path.robot[-1])
    before, halfway, after = planar_pose(*np.stack([path.robot[1], middle, path.robot[2]])[:, :3].T)
    turned = path.robot[2, 2] - path.robot[1, 2]
    assert abs(turned) > 1e-2
    np.testing.assert_allclose(relative(after, halfway), relative(halfway, before), atol=1e-9)
    scales = [path.time_scale_at(path.seconds[i] - 0.5 * HORIZON) for i in (1, 2)]
    assert scales == path.time_scale[1:3].tolist()


def test_a_partial_path_ends_where_no_robot_goes_on(planned, solver):
    path, _ = planned([0.0, 0.0, 0.2, 0.0, 0.0, 0.0], partial=True)
    assert not path.complete
    ee = compose(planar_pose(*path.robot[-1:, :3].T), forward(solver.chain, path.robot[-1:, 3:]))
    assert ee[0, 2] == pytest.approx(path.ee_at(path.seconds[-1])[2], abs=0.1)
    assert ee[0, 2] > path.ee[0, 2] + 0.1
    assert planned([0.05, 0.0, 0.0, 0.0, 0.0, 0.0], partial=True)[0].complete


@pytest.mark.parametrize("rate", [-0.3, 0.3])
def test_arms_jump_only_where_a_partial_path_would_end(rate):
    solver = IkSolver(load_robot("lekiwi"))
    robot, joints = solver.robot, solver.robot.home["home"]
    ee = forward(solver.chain, joints[np.newaxis])[0]
    roll = rate * rotation(ee).as_matrix()[:, 1]  # 6 rad in 20 s; no joint turns as far
    time = np.arange(0.0, 20.0, HORIZON)[:, np.newaxis]
    poses = integrate(ee, np.concatenate([np.zeros(3), roll]) * time, 1.0)
    motion = AT_ORIGIN, joints, poses, HORIZON, 0.0
    planner = BasePathPlanner(solver)
    assert planner.plan(*motion) is None
    path = planner.plan(*motion, partial=True)
    assert path.complete
    moved = np.abs(joint_displacement(robot, path.robot[:-1, 3:], path.robot[1:, 3:]))
    seconds = np.diff(path.seconds) / path.time_scale[1:]
    (jump,) = np.flatnonzero(
        (moved > seconds[:, np.newaxis] * robot.max_joint_velocity).any(axis=1)
    )
    before, after = path.robot[jump : jump + 2]
    np.testing.assert_array_equal(before[:3], after[:3])
    np.testing.assert_array_equal(path.robots_at(path.seconds[[jump]])[0], after)


def test_the_robot_moves_already_while_the_ee_rests(planned, solver):
    path, _ = planned([0.3, 0.0, 0.0, 0.0, 0.0, 0.5], 5.0, rest=3.0)
    assert path.complete
    assert path.seconds[0] == pytest.approx(2.0)
    np.testing.assert_array_equal(path.ee_at(-20.0), path.ee[0])
    rests = path.robot[path.seconds < 5.0 + 1e-6]
    ee = compose(planar_pose(*rests[:, :3].T), forward(solver.chain, rests[:, 3:]))
    assert_near(ee, path.ee[0], 0.1, 0.21)
    assert np.ptp(rests[:, :2], axis=0).max() > 0.02


def test_an_ee_that_starts_too_fast_is_slow_after_its_rest_only(solver):
    joints = solver.robot.home["home"]
    moved = 0.8 * np.arange(0.0, 5.0, HORIZON).clip(max=0.6)[:, np.newaxis]
    ee = integrate(forward(solver.chain, joints[np.newaxis])[0], np.eye(6)[0] * moved, 1.0)
    path = BasePathPlanner(solver).plan(AT_ORIGIN, joints, ee, HORIZON, 5.0, rest=3.0)
    slow = path.seconds[path.time_scale < 1.0]
    assert slow.size and slow.min() > 5.0 + 1e-6


def test_a_slow_motion_gives_the_base_more_time(planned):
    quick = planned([0.3, 0.0, 0.0, 0.0, 0.0, 0.0], 5.0)[0]
    slow, _ = planned([0.3, 0.0, 0.0, 0.0, 0.0, 0.0], 5.0, time_scale=0.2)
    assert slow is not None
    assert quick is None or quick.time_scale.min() < slow.time_scale.min() == 1.0


@pytest.mark.parametrize(("clearance", "speed"), [(0.0, 0.0), (0.03, 0.0), (0.0, 0.2)])
def test_paths_keep_a_clearance_from_solids(planned, solver, clearance, speed):
    twist, solids = [0.1, 0.0, 0.0, 0.0, 0.0, 0.0], Solids.empty(1, 1)
    free, _ = planned(twist)
    middle = len(free.robot) // 2
    x, y = free.robot[middle, :2]
    away = speed * (free.seconds[middle] - free.seconds[0])  # it crosses the path
    solids.pose[0, 0], solids.size[0, 0] = (x, y - 0.3 - away, 0.0), (0.1, 0.1, 0.0, 0.4)
    solids.velocity[0, 0, 1], solids.span[0, 0] = speed, 100.0

    def touches(path, margin):
        base, arm = planar_pose(*path.robot[1:, :3].T), np.ascontiguousarray(path.robot[1:, 3:])
        seconds = np.cumsum(np.diff(path.seconds) / path.time_scale[1:])
        around = solids.wider(margin, margin).repeated(len(arm)).at(seconds)
        return collides(solver.collision, arm, base, around).any()

    assert touches(free, 0.0)
    around, _ = planned(twist, solids=solids, clearance=clearance)
    assert not touches(around, clearance)


def test_bases_do_not_drive_through_solids_between_poses(solver):
    robot, seconds, pole, count = solver.robot, 3.0, Solids.empty(1, 1), 0
    joints, expander = robot.home["home"], BeamExpander(solver)
    pole.size[0, 0] = 0.01, 0.01, 0.0, 0.4
    first, target = expander.first(AT_ORIGIN, joints), forward(solver.chain, joints)
    target[1] -= 0.2
    for bearing in -np.pi * np.linspace(0.3, 0.7, 21):
        pole.pose[0, 0] = 0.3 * np.cos(bearing), 0.3 * np.sin(bearing), 0.0
        beam = expander.moved(first, target, seconds, np.random.default_rng(0), pole)
        count += len(beam.cost)
        for part in np.arange(1.0, 8.0) / 8.0:
            base = AT_ORIGIN[np.newaxis].repeat(len(beam.cost), axis=0)
            twist = base_twist(robot.base, base, beam.command, part * seconds / 2.0)
            base = integrate(base, twist, part * seconds)
            assert not base_collides(solver.collision, base, pole.repeated(len(base))).any()
    assert count > 20
