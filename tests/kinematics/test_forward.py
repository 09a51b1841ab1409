import ast
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import kinfeas
from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import rotation
from kinfeas.core.start import episode_rng
from kinfeas.kinematics.forward import build_chain, forward, jacobian
from kinfeas.kinematics.gravity import build_gravity_model, gravity_torques, overloaded
from kinfeas.kinematics.ik import IkSolver
from kinfeas.planning.placement import Postures
from kinfeas.robots.loading import load_robot
from kinfeas.tasks.loading import load_task
from kinfeas.tasks.task import sample_start
from tests.kinematics.conftest import draw

DECORATORS = {"kernel", "inner", "inlined", "compiled", "njit"}
DECORATORS |= {"exact", "exact_inner", "exact_inlined"}
EXACT = {"rtol": 0.0, "atol": 1e-9}


def test_poses_and_jacobians_are_those_of_pinocchio(robot, judge):
    joints, chain = draw(robot, 200), build_chain(robot)
    ee_pose, jacobians = forward(chain, joints), jacobian(chain, joints)
    turns = rotation(ee_pose).as_matrix()
    for i, positions in enumerate(joints):
        position, turn = judge.pose(positions)
        np.testing.assert_allclose(ee_pose[i, :3], position, **EXACT)
        np.testing.assert_allclose(turns[i], turn, **EXACT)
        np.testing.assert_allclose(jacobians[i], judge.jacobian(positions), **EXACT)
    np.testing.assert_allclose(np.linalg.norm(ee_pose[:, 3:], axis=1), 1.0, **EXACT)
    assert ee_pose[:, 6].min() >= 0.0


@pytest.mark.parametrize("function", [forward, jacobian])
def test_another_number_of_joints_is_an_error(hsr, function):
    with pytest.raises(KinfeasError, match="joint positions"):
        function(build_chain(hsr), np.zeros((2, 99)))


def test_no_kernel_has_powers():
    """Numba compiles `**` once a process, with the flags of the first kernel that has one."""
    found = 0
    for path in Path(kinfeas.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            decorators = getattr(node, "decorator_list", [])
            names = {n.id for whole in decorators for n in ast.walk(whole) if type(n) is ast.Name}
            if names & DECORATORS:
                found += 1
                assert not any(isinstance(part, ast.Pow) for part in ast.walk(node)), node.name
    assert found > 30


def test_gravity_torques_are_those_of_pinocchio(robot, judge):
    joints = draw(robot, 100)
    torques = gravity_torques(build_gravity_model(robot), joints)
    expected = [judge.gravity_torques(positions) for positions in joints]
    assert np.abs(expected).max() > 1.0
    np.testing.assert_allclose(torques, expected, atol=1e-9)


def weak(robot, joint, fraction):
    """Return a robot that can hold only so many configurations, since one joint is weak."""
    model, j = build_gravity_model(robot), [arm_joint.name for arm_joint in robot.arm].index(joint)
    torque = np.quantile(np.abs(gravity_torques(model, draw(robot, 500))[:, j]), fraction)
    joints = robot.urdf.joints | {joint: replace(robot.urdf.joints[joint], effort=2.0 * torque)}
    return replace(robot, urdf=replace(robot.urdf, joints=joints), max_gravity_load=0.5)


@pytest.fixture(scope="module")
def weak_tiago():
    return weak(load_robot("tiago"), "arm_2_joint", 0.6)


def test_limits_are_those_of_motors(weak_tiago):
    names = [joint.name for joint in weak_tiago.arm]
    model, drawn = build_gravity_model(weak_tiago), draw(weak_tiago, 300)
    joints = dict(weak_tiago.urdf.joints)
    torques, beyond = np.abs(gravity_torques(model, drawn)), overloaded(model, drawn)
    efforts = np.array([joints[name].effort for name in names])
    np.testing.assert_array_equal(beyond, torques > 0.5 * efforts)
    assert 0.3 < beyond.any(axis=1).mean() < 0.5
    for effort in (0.0, np.inf):  # none is set
        joints["arm_2_joint"] = replace(joints["arm_2_joint"], effort=effort)
        other = replace(weak_tiago, urdf=replace(weak_tiago.urdf, joints=joints))
        assert not overloaded(build_gravity_model(other), drawn)[
            :, names.index("arm_2_joint")
        ].any()
    sprung = replace(weak_tiago, counterbalanced=frozenset(names))
    for other in (sprung, replace(weak_tiago, max_gravity_load=None)):
        assert not build_gravity_model(other).limited
        assert not overloaded(build_gravity_model(other), drawn).any()


def test_solutions_can_be_held(weak_tiago):
    solver, strong = IkSolver(weak_tiago), IkSolver(replace(weak_tiago, max_gravity_load=None))
    joints = draw(weak_tiago, 600)
    beyond = overloaded(solver.gravity, joints).any(axis=1)
    held = solver.admissible(joints)
    assert not np.any(held & beyond)
    np.testing.assert_array_equal(strong.admissible(joints) & ~beyond, held)
    targets, seeds = forward(solver.chain, joints[held]), joints[~held][: held.sum()]
    targets = targets[: len(seeds)]
    result, free = solver.solve(targets, seeds), strong.solve(targets, seeds)
    assert result.feasible.mean() > 0.9
    assert not overloaded(solver.gravity, result.joint_positions[result.feasible]).any()
    assert overloaded(solver.gravity, free.joint_positions[free.feasible]).any()
    # The search also goes on where the seed itself would be a solution.
    here = joints[strong.admissible(joints) & beyond][:100]
    result = solver.solve(forward(solver.chain, here), here, np.full(here.shape[1], 0.1))
    assert not overloaded(solver.gravity, result.joint_positions[result.feasible]).any()
    assert result.feasible.any()


def test_starts_and_proposed_postures_can_be_held(weak_tiago):
    solver, task = IkSolver(weak_tiago), load_task("ggr")
    assert not overloaded(solver.gravity, Postures(solver).joints).any()
    for episode in range(8):
        start = sample_start(task, solver, episode_rng(1, episode))
        assert solver.admissible(start.joint_positions)
