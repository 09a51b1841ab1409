import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kinfeas.control.observation import (
    HORIZON,
    OBSERVATION,
    Seen,
    check_terms,
    describe_action,
    describe_observation,
    observe,
    scale,
    size,
    surroundings,
)
from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import compose, integrate, make_pose, planar_pose, relative, rotation
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import spread_configurations


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
    action = describe_action(robot)
    assert action.scale == (robot.base.max_velocity,) * 2 + (robot.base.max_rotation,)
    with pytest.raises(KinfeasError, match=r"file: observation .*'lidar'"):
        check_terms(["lidar"], "file: observation")
