import ast
from pathlib import Path

import numpy as np
import pytest

import kinfeas
from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import rotation
from kinfeas.kinematics.forward import build_chain, forward, jacobian
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
