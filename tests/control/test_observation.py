import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kinfeas.control.observation import (
    ACTION,
    ACTIONS,
    HORIZON,
    OBSERVATION,
    SLOWEST,
    TERMS,
    Seen,
    action_size,
    check_terms,
    describe_action,
    describe_observation,
    observe,
    scale,
    size,
    split_action,
    surroundings,
)
from kinfeas.core.errors import KinfeasError
from kinfeas.core.policy import TermInfo
from kinfeas.core.spatial import compose, integrate, make_pose, planar_pose, relative, rotation
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import spread_configurations
from kinfeas.robots.loading import load_robot


def parts(solver, n=50, seed=0):
    """Return base pose, EE pose in base, planned pose, goal and joints of n random robots."""
    rng = np.random.default_rng(seed)
    joints = spread_configurations(solver.robot, n, seed)
    base = planar_pose(*rng.uniform(-3.0, 3.0, (2, n)), rng.uniform(-np.pi, np.pi, n))
    ee_in_base = forward(solver.chain, joints)
    planned = integrate(compose(base, ee_in_base), rng.uniform(-0.1, 0.1, (n, 6)), HORIZON)
    goal = make_pose(rng.uniform(-2.0, 2.0, (n, 3)), Rotation.random(n, rng=rng))
    return base, ee_in_base, planned, goal, joints


def term(name, *given):
    return observe(Seen(*given), [name])


def test_terms_are_in_order_and_those_that_are_asked_for(solver):
    given = parts(solver)
    base, ee_in_base, _, goal, joints = given
    whole = observe(Seen(*given))
    assert whole.shape == (50, size(solver.robot)) == (50, 21 + joints.shape[1])
    np.testing.assert_array_equal(whole, np.hstack([term(name, *given) for name in OBSERVATION]))
    pose = np.hstack([term("ee_position", *given), term("ee_orientation", *given)])
    np.testing.assert_array_equal(pose, ee_in_base)
    pose = np.hstack([term("goal_position", *given), term("goal_orientation", *given)])
    np.testing.assert_allclose(pose, relative(goal, base), atol=1e-12)
    np.testing.assert_array_equal(term("joint_positions", *given), joints)


def test_planned_motion_leads_from_the_achieved_to_the_planned_pose(solver):
    base, ee_in_base, planned, goal, joints = parts(solver)
    planned[:, 0] += 0.3  # far from the desired pose: the tracking error is part of the velocity
    given = (base, ee_in_base, planned, goal, joints)
    position = ee_in_base[:, :3] + HORIZON * term("planned_velocity", *given)
    change = Rotation.from_quat(term("planned_rotation", *given))
    reached = compose(base, make_pose(position, change * rotation(ee_in_base)))
    np.testing.assert_allclose(reached[:, :3], planned[:, :3], atol=1e-12)
    angle = (rotation(reached).inv() * rotation(planned)).magnitude()
    np.testing.assert_allclose(angle, 0.0, atol=1e-7)


@pytest.mark.parametrize("turn", [0.3, -2.0, np.pi])
def test_moving_the_world_changes_nothing(solver, turn):
    base, ee_in_base, planned, goal, joints = parts(solver)
    world = planar_pose(np.array(4.0), np.array(-7.0), np.array(turn))
    moved = [compose(np.broadcast_to(world, pose.shape), pose) for pose in (base, planned, goal)]
    before = observe(Seen(base, ee_in_base, planned, goal, joints))
    after = observe(Seen(moved[0], ee_in_base, moved[1], moved[2], joints))
    # At a half turn, rounding decides between a quaternion and its negative.
    half_turn = np.abs(before[:, [6, 13, 20]]).min(axis=1) < 1e-9
    np.testing.assert_allclose(after[~half_turn], before[~half_turn], atol=1e-9)
    assert half_turn.sum() <= 1


def test_scales_and_descriptions_have_the_size_of_observations(robot):
    assert scale(robot).shape == (size(robot),)
    # The w of a small rotation is 1.
    np.testing.assert_array_equal(scale(robot, ["planned_rotation"]), [20.0, 20.0, 20.0, 1.0])
    described = describe_observation(robot, OBSERVATION)
    assert [one.name for one in described] == list(OBSERVATION)
    assert sum(one.size for one in described) == size(robot)
    assert described[-1].entries == tuple(joint.name for joint in robot.arm)
    n = size(robot)
    assert surroundings(robot, (*OBSERVATION, "planned_base")) == [n, n + 1, n + 2]
    (action,) = describe_action(robot)
    assert action.scale == (robot.base.max_velocity,) * 2 + (robot.base.max_rotation,)
    with pytest.raises(KinfeasError, match=r"file: observation: unknown term 'lidar'"):
        check_terms([TermInfo("lidar", 3, "", "")], tuple(TERMS), "file: observation")


def test_actions_are_split_into_their_terms():
    action = np.array([[0.5, -0.5, 1.0, 2.0], [0.2, 0.1, -3.0, 0.5]])
    command, scale, torso = split_action(action, ACTIONS)
    np.testing.assert_array_equal(command, action[:, :2])
    np.testing.assert_allclose(scale, [1.0, SLOWEST])
    np.testing.assert_array_equal(torso, [1.0, 0.5])
    command, scale, torso = split_action(action, (*ACTION, "torso_velocity"))
    assert command.shape == (2, 3) and scale is None
    np.testing.assert_array_equal(torso, [1.0, 0.5])
    assert split_action(action, ACTION)[1:] == (None, None)
    described = describe_action(load_robot("tiago"), ACTIONS)
    assert [(one.name, one.scale) for one in described[1:]] == [
        ("time_scale", (1.0,)),
        ("torso_velocity", (0.07,)),
    ]
    with pytest.raises(KinfeasError, match="no torso"):
        action_size(load_robot("pr2"), ACTIONS)
