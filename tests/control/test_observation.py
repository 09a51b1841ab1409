import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kinfeas.control.observation import (
    HORIZON,
    OBSERVATION,
    ObservedState,
    observe,
    size,
    surroundings_columns,
)
from kinfeas.core.spatial import compose, integrate, make_pose, relative, rotation
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import spread_configurations
from tests.builders import assert_near, random_bases, random_poses


@pytest.fixture
def parts(solver, n=50):
    """Base pose, EE pose in base, planned pose, goal and joints of n random robots."""
    joints, base = spread_configurations(solver.robot, n, 0), random_bases(n)
    ee_in_base = forward(solver.chain, joints)
    twist = np.random.default_rng(0).uniform(-0.1, 0.1, (n, 6))
    planned = integrate(compose(base, ee_in_base), twist, HORIZON)
    return base, ee_in_base, planned, random_poses(n, 1, 2.0), joints


def test_terms_are_in_order(parts, robot):
    base, ee_in_base, _, goal, joints = parts
    whole = observe(ObservedState(*parts))
    assert whole.shape == (50, size(robot)) == (50, 21 + joints.shape[1])
    terms = {name: observe(ObservedState(*parts), [name]) for name in OBSERVATION}
    np.testing.assert_array_equal(whole, np.hstack(list(terms.values())))
    pose = np.hstack([terms["ee_position"], terms["ee_orientation"]])
    np.testing.assert_array_equal(pose, ee_in_base)
    pose = np.hstack([terms["goal_position"], terms["goal_orientation"]])
    np.testing.assert_allclose(pose, relative(goal, base), atol=1e-12)
    np.testing.assert_array_equal(terms["joint_positions"], joints)
    n = size(robot)
    assert surroundings_columns(robot, (*OBSERVATION, "planned_base")) == [n, n + 1, n + 2]


def test_planned_motion_leads_from_the_achieved_to_the_planned_pose(parts):
    base, ee_in_base, planned, goal, joints = parts
    planned[:, 0] += 0.3  # far from the desired pose: the tracking error is part of the velocity
    terms = observe(
        ObservedState(base, ee_in_base, planned, goal, joints),
        ["planned_velocity", "planned_rotation"],
    )
    position = ee_in_base[:, :3] + HORIZON * terms[:, :3]
    change = Rotation.from_quat(terms[:, 3:])
    reached = compose(base, make_pose(position, change * rotation(ee_in_base)))
    assert_near(reached, planned, 1e-9, 1e-7)
