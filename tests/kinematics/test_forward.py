import importlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from numba.core.registry import CPUDispatcher
from scipy.spatial.transform import Rotation

from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import rotation, twist_between
from kinfeas.kinematics.forward import build_chain, forward, jacobian
from kinfeas.robots.loading import load_robot
from kinfeas.robots.robot import ArmJoint

GOLDEN = yaml.safe_load((Path(__file__).parents[1] / "robots" / "golden_fk.yaml").read_text())
CASES = [
    pytest.param(name, chain["joints"], case, id=f"{name}-{chain['joints'][1]}-{case['name']}")
    for name, chains in GOLDEN.items() for chain in chains for case in chain["cases"]
]  # fmt: skip
EXACT = {"rtol": 0.0, "atol": 1e-9}


def check_poses(robot, judge, joints):
    ee_pose = forward(build_chain(robot), joints)
    turns = rotation(ee_pose).as_matrix()
    for i, positions in enumerate(joints):
        position, turn = judge.pose(positions)
        np.testing.assert_allclose(ee_pose[i, :3], position, **EXACT)
        np.testing.assert_allclose(turns[i], turn, **EXACT)


def check_jacobians(robot, judge, joints):
    found = jacobian(build_chain(robot), joints)
    for i, positions in enumerate(joints):
        np.testing.assert_allclose(found[i], judge.jacobian(positions), **EXACT)


def differentiate(chain, joints, step=1e-6):
    """Return the Jacobian by central differences, shape (n, 6, v)."""
    columns = []
    for j in range(joints.shape[1]):
        shift = np.zeros(joints.shape[1])
        shift[j] = step
        ends = forward(chain, joints - shift), forward(chain, joints + shift)
        columns.append(twist_between(*ends, 2.0 * step))
    return np.stack(columns, axis=-1)


def test_poses_are_pinocchios(robot, judge, draw):
    check_poses(robot, judge, draw(robot, 300))


def test_jacobians_are_pinocchios(robot, judge, draw):
    check_jacobians(robot, judge, draw(robot, 300))


def test_odd_axes_origins_and_followers_are_pinocchios(odd_robot, odd_judge, draw):
    joints = draw(odd_robot, 300)
    check_poses(odd_robot, odd_judge, joints)
    check_jacobians(odd_robot, odd_judge, joints)


@pytest.mark.parametrize(("name", "joints", "case"), CASES)
def test_golden_poses(name, joints, case):
    robot = load_robot(name)
    arm = tuple(ArmJoint(joint, -9.0, 9.0, 1.0, continuous=False) for joint in joints)
    for frame, expected in case["frames"].items():
        chain = build_chain(replace(robot, arm=arm, ee_frame=frame))
        found = forward(chain, np.array(case["positions"]))
        turn = Rotation.from_quat(expected[3:]).as_matrix()
        np.testing.assert_allclose(found[:3], expected[:3], **EXACT)
        np.testing.assert_allclose(rotation(found).as_matrix(), turn, **EXACT)


def test_jacobian_is_the_derivative(robot, draw):
    chain, joints = build_chain(robot), draw(robot, 50, seed=1)
    np.testing.assert_allclose(
        jacobian(chain, joints), differentiate(chain, joints), rtol=0.0, atol=1e-8
    )


def test_jacobian_of_followers_is_the_derivative(odd_robot, draw):
    chain, joints = build_chain(odd_robot), draw(odd_robot, 50, seed=1)
    np.testing.assert_allclose(
        jacobian(chain, joints), differentiate(chain, joints), rtol=0.0, atol=1e-8
    )


@pytest.mark.parametrize("leading", [(), (3,), (2, 3), (0,)])
def test_shapes_and_rows_do_not_depend_on_the_batch(robot, draw, leading):
    chain, joints = build_chain(robot), draw(robot, 6)
    count = int(np.prod(leading))
    some = joints[:count].reshape(*leading, len(robot.arm))
    assert forward(chain, some).shape == (*leading, 7)
    assert jacobian(chain, some).shape == (*leading, 6, len(robot.arm))
    np.testing.assert_array_equal(
        forward(chain, some).reshape(-1, 7), forward(chain, joints)[:count]
    )
    np.testing.assert_array_equal(
        jacobian(chain, some).reshape(-1, 6, len(robot.arm)), jacobian(chain, joints)[:count]
    )


def test_any_memory_layout_and_number_type(robot, draw):
    chain, joints = build_chain(robot), draw(robot, 6)
    expected = forward(chain, joints)
    np.testing.assert_array_equal(forward(chain, np.asfortranarray(joints)), expected)
    np.testing.assert_array_equal(forward(chain, np.repeat(joints, 2, axis=0)[::2]), expected)
    np.testing.assert_array_equal(
        forward(chain, np.zeros(len(robot.arm), dtype=int)),
        forward(chain, np.zeros(len(robot.arm))),
    )


def test_quaternions_are_unit_with_w_not_negative(robot, draw):
    quaternion = forward(build_chain(robot), draw(robot, 1000))[:, 3:]
    np.testing.assert_allclose(np.linalg.norm(quaternion, axis=1), 1.0, **EXACT)
    assert quaternion[:, 3].min() >= 0.0


@pytest.mark.parametrize("shape", [(1, 3), (3,), (), (4, 0), (0, 1), (2, 3, 99)])
@pytest.mark.parametrize("function", [forward, jacobian])
def test_another_number_of_joints_is_refused(odd_robot, function, shape):
    with pytest.raises(KinfeasError, match=r"^joint positions must be of shape \(\.\.\., 8\), not"):
        function(build_chain(odd_robot), np.zeros(shape))


def test_joints_off_the_chain_count(odd_robot):
    shorter = build_chain(replace(odd_robot, ee_frame=odd_robot.urdf.root))
    n = len(odd_robot.arm)
    assert forward(shorter, np.zeros((2, n))).shape == (2, 7)
    with pytest.raises(KinfeasError, match="joint positions must be of shape"):
        forward(shorter, np.zeros((2, n - 1)))


@pytest.mark.parametrize("name", ["convex", "descent", "forward", "search", "self_collision"])
def test_every_kernel_says_whether_it_is_inlined(name):
    """One that does not does as its first caller: whole searches were, and compiled for minutes."""
    module = importlib.import_module(f"kinfeas.kinematics.{name}")
    kernels = [entry for entry in vars(module).values() if isinstance(entry, CPUDispatcher)]
    assert kernels
    assert all("forceinline" in kernel.targetoptions for kernel in kernels)
