import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kinfeas.control.observation import FIELDS, HORIZON, observe, scale, size
from kinfeas.core.spatial import compose, integrate, make_pose, planar_pose, relative, rotation
from kinfeas.kinematics.forward import forward

PLACES = {}
start = 0
for name, count in FIELDS:
    PLACES[name] = slice(start, start + count)
    start += count


def random_poses(n, rng):
    return make_pose(rng.uniform(-2.0, 2.0, (n, 3)), Rotation.random(n, rng=rng))


def scene(solver, n=50, seed=0):
    """Return base pose, EE pose in base, planned pose, goal and joints of n robots at random."""
    rng = np.random.default_rng(seed)
    lower = [max(joint.lower, -np.pi) for joint in solver.robot.arm]
    upper = [min(joint.upper, np.pi) for joint in solver.robot.arm]
    joints = rng.uniform(lower, upper, (n, len(lower)))
    base = planar_pose(*rng.uniform(-3.0, 3.0, (2, n)), rng.uniform(-np.pi, np.pi, n))
    ee_in_base = forward(solver.chain, joints)
    planned = integrate(compose(base, ee_in_base), rng.uniform(-0.1, 0.1, (n, 6)), HORIZON)
    return base, ee_in_base, planned, random_poses(n, rng), joints


def test_layout(solver):
    base, ee_in_base, planned, goal, joints = scene(solver)
    observed = observe(base, ee_in_base, planned, goal, joints)
    assert observed.shape == (50, size(joints.shape[1])) == (50, 21 + joints.shape[1])
    ee = np.concatenate(
        [observed[:, PLACES[f"ee_{k}"]] for k in ("position", "orientation")], axis=1
    )
    np.testing.assert_array_equal(ee, ee_in_base)
    np.testing.assert_allclose(observed[:, 14:21], relative(goal, base), atol=1e-12)
    np.testing.assert_array_equal(observed[:, 21:], joints)


def test_planned_motion_leads_from_the_achieved_to_the_planned_pose_in_the_base_frame(solver):
    base, ee_in_base, planned, goal, joints = scene(solver)
    # Far from the desired pose: what is shown holds the error to catch up with.
    planned[:, 0] += 0.3
    observed = observe(base, ee_in_base, planned, goal, joints)
    position = ee_in_base[:, :3] + HORIZON * observed[:, PLACES["planned_velocity"]]
    change = Rotation.from_quat(observed[:, PLACES["planned_rotation"]])
    reached = compose(base, make_pose(position, change * rotation(ee_in_base)))
    np.testing.assert_allclose(reached[:, :3], planned[:, :3], atol=1e-12)
    angle = (rotation(reached).inv() * rotation(planned)).magnitude()
    np.testing.assert_allclose(angle, 0.0, atol=1e-7)


def test_a_turn_is_seen_about_the_axes_of_the_base(solver):
    """The EE rolls about the world's x; a base that heads along y sees it about its own -y."""
    base, ee_in_base, _, goal, joints = scene(solver, 1)
    base = planar_pose(np.zeros(1), np.zeros(1), np.full(1, np.pi / 2))
    twist = np.array([[0.0, 0.0, 0.0, 0.5, 0.0, 0.0]])
    planned = integrate(compose(base, ee_in_base), twist, HORIZON)
    observed = observe(base, ee_in_base, planned, goal, joints)
    vector = Rotation.from_quat(observed[:, PLACES["planned_rotation"]]).as_rotvec()
    np.testing.assert_allclose(vector, [[0.0, -0.5 * HORIZON, 0.0]], atol=1e-9)


@pytest.mark.parametrize("turn", [0.3, -2.0, np.pi])
def test_moving_the_world_changes_nothing(solver, turn):
    base, ee_in_base, planned, goal, joints = scene(solver)
    world = planar_pose(np.array(4.0), np.array(-7.0), np.array(turn))
    moved = [compose(np.broadcast_to(world, pose.shape), pose) for pose in (base, planned, goal)]
    before = observe(base, ee_in_base, planned, goal, joints)
    after = observe(moved[0], ee_in_base, moved[1], moved[2], joints)
    # Where w is about 0, rounding decides between a quaternion and its negative.
    half_turn = np.abs(before[:, [6, 13, 20]]).min(axis=1) < 1e-9
    np.testing.assert_allclose(after[~half_turn], before[~half_turn], atol=1e-9)
    assert half_turn.sum() <= 1


def test_quaternions_are_unit_with_w_not_negative(solver):
    observed = observe(*scene(solver, 500))
    for name, place in PLACES.items():
        if name.endswith(("orientation", "rotation")):
            quaternion = observed[:, place]
            np.testing.assert_allclose(np.linalg.norm(quaternion, axis=1), 1.0, atol=1e-12)
            assert quaternion[:, 3].min() >= 0.0


def test_at_rest_nothing_is_planned(solver):
    base, ee_in_base, _, goal, joints = scene(solver)
    observed = observe(base, ee_in_base, compose(base, ee_in_base), goal, joints)
    np.testing.assert_allclose(observed[:, PLACES["planned_velocity"]], 0.0, atol=1e-13)
    np.testing.assert_allclose(
        observed[:, PLACES["planned_rotation"]], np.tile([0, 0, 0, 1.0], (50, 1)), atol=1e-12
    )


def test_scale_has_a_factor_for_each_number(robot):
    factors = scale(len(robot.arm))
    assert factors.shape == (size(len(robot.arm)),)
    assert np.all(factors > 0.0)
    # The w of a small turn is 1 and carries nothing to blow up.
    assert factors[PLACES["planned_rotation"]][3] == 1.0
    assert np.all(factors[PLACES["planned_rotation"]][:3] > 1.0)


def test_rows_do_not_depend_on_the_batch(solver):
    parts = scene(solver, 37)
    together = observe(*parts)
    for i in range(37):
        np.testing.assert_array_equal(
            observe(*(part[i : i + 1] for part in parts)), together[i : i + 1]
        )
