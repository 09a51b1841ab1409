import pickle
from dataclasses import replace

import numpy as np
import pytest

from kinfeas.control.drive import action_size, base_twist
from kinfeas.control.observation import HORIZON
from kinfeas.core.errors import KinfeasError
from kinfeas.kinematics.forward import build_chain, forward, jacobian
from kinfeas.kinematics.ik import spread_configurations
from kinfeas.policies.baselines import whole_body_qp as module
from kinfeas.policies.baselines.whole_body_qp import WholeBodyQp, build_model, whole_body_qp
from kinfeas.robots.urdf import Mimic
from tests.policies.baselines.policy_inputs import policy_inputs, rows_of, turned_about

pin = pytest.importorskip("pinocchio")
pytest.importorskip("pink")


def test_the_model_is_our_robot(robot):
    model, chain, carried = build_model(robot), build_chain(robot), action_size(robot.base)
    data, frame = model.createData(), model.getFrameId("ee")
    joints = spread_configurations(robot, 20)
    for q, pose, columns in zip(
        joints, forward(chain, joints), jacobian(chain, joints), strict=True
    ):
        full = np.concatenate([np.zeros(carried), q])
        found = pin.computeFrameJacobian(
            model, data, full, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        )
        pin.framesForwardKinematics(model, data, full)
        np.testing.assert_allclose(pin.SE3ToXYZQUAT(data.oMf[frame])[:3], pose[:3], atol=1e-9)
        np.testing.assert_allclose(found[:, carried:], columns, atol=1e-9)


def test_the_base_moves_as_its_drive_can(robot):
    model, carried = build_model(robot), action_size(robot.base)
    data, frame = model.createData(), model.getFrameId("ee")
    q = np.concatenate([np.zeros(carried), robot.home["home"]])
    found = pin.computeFrameJacobian(model, data, q, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)[
        :, :carried
    ]
    x, y, _ = forward(build_chain(robot), robot.home["home"])[:3]
    ways = [[1, 0, 0, 0, 0, 0], [0, 1, 0, 0, 0, 0]][: carried - 1]
    np.testing.assert_allclose(found.T, [*ways, [-y, x, 0, 0, 0, 1]], atol=1e-9)


def test_a_comfortable_arm_far_from_its_goal_is_carried_there(robot):
    joints = np.array([(j.lower + j.upper) / 2.0 if not j.continuous else 0.0 for j in robot.arm])
    forward_motion = np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.0])
    base = np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]])
    policy_input = policy_inputs(robot, 1, forward_motion, base_pose=base, joints=joints[None])
    action = whole_body_qp(robot).act(policy_input)
    assert base_twist(robot.base, base, action, HORIZON)[0, 0] > 0.03


def test_stays_within_bounds(robot):
    policy_input = policy_inputs(robot, 50, np.array([3.0, -4.0, 1.0, 1.0, -1.0, 2.0]))
    action = WholeBodyQp(robot).act(policy_input)
    assert action.shape == (50, action_size(robot.base))
    assert np.abs(action).max() <= 1.0
    assert np.abs(action).max() > 0.5


def test_joints_a_little_beyond_their_limits_are_no_trouble(robot):
    policy_input = policy_inputs(robot, 20)
    policy_input.observation[:, 21:] += 0.01 * np.sign(policy_input.observation[:, 21:])
    assert np.isfinite(WholeBodyQp(robot).act(policy_input)).all()


def test_does_not_depend_on_the_map_or_on_the_batch(robot):
    policy, policy_input = WholeBodyQp(robot), policy_inputs(robot, 20)
    action = policy.act(policy_input)
    elsewhere = turned_about(policy_input, 2.0, (3.0, -1.0))
    np.testing.assert_allclose(policy.act(elsewhere), action, atol=1e-6)
    rows = [19, 4]
    np.testing.assert_array_equal(policy.act(rows_of(policy_input, rows)), action[rows])


def test_survives_pickling_after_use(robot):
    policy, policy_input = WholeBodyQp(robot), policy_inputs(robot, 5)
    action = policy.act(policy_input)
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(policy)).act(policy_input), action)


def test_a_missing_library_says_what_to_install(robot, monkeypatch):
    monkeypatch.setattr(module, "find_spec", lambda name: None if name == "pink" else name)
    with pytest.raises(KinfeasError, match=r'needs pink: pip install "kinfeas\[qp\]"'):
        whole_body_qp(robot)


def test_a_joint_that_follows_another_is_refused(robot):
    with pytest.raises(KinfeasError, match="must move by itself"):
        whole_body_qp(_with_follower(robot))


def _with_follower(robot):
    """Return the robot with its last arm joint following the one before."""
    *arm, last = robot.arm
    joints = dict(robot.urdf.joints)
    joints[last.name] = replace(joints[last.name], mimic=Mimic(arm[-1].name, -0.5, 0.1))
    return replace(robot, arm=tuple(arm), urdf=replace(robot.urdf, joints=joints))
