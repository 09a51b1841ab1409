import numpy as np
import pytest

from kinfeas.core.solids import Solids
from kinfeas.core.spatial import compose, integrate, planar_pose, relative, wrap
from kinfeas.kinematics.base_path import BasePathPlanner
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolver
from kinfeas.kinematics.solids import collides
from kinfeas.robots.loading import load_robot

STEPS, SECONDS = 12, 2.0
HERE = planar_pose(*np.zeros(3))


@pytest.fixture(scope="module", params=["pr2", "hsr"])
def planner(request):
    return BasePathPlanner(IkSolver(load_robot(request.param)))


def line(planner, *velocity):
    """Return EE poses at even steps from the home configuration, shape (13, 7)."""
    ee = compose(HERE, forward(planner.solver.chain, planner.robot.home["home"]))
    twist = np.array([*velocity, 0.0, 0.0, 0.0])
    return np.stack([integrate(ee, twist, SECONDS * step) for step in range(STEPS + 1)])


def plan(planner, path, solids=None):
    home = planner.robot.home["home"]
    return planner.plan(path, np.full(STEPS, SECONDS), HERE, home, solids)


def step(x, y):
    one = np.array([[[x, y, 0.0]]]), np.array([[[0.2, 0.2, 0.0, 0.25]]])
    return Solids(*one, np.zeros((1, 1), dtype=np.bool_), np.zeros((1, 1, 2)), np.zeros((1, 1)))


@pytest.mark.parametrize("among", [False, True])
def test_a_base_path_is_reachable_fast_enough_and_free(planner, among):
    path = line(planner, 0.1, 0.0, 0.0)
    solids = step(1.3, 0.0) if among else None
    joints = plan(planner, path, solids)
    np.testing.assert_array_equal(joints, plan(planner, path, solids))
    assert len(joints) == STEPS + 1
    lower, upper = planner.robot.joint_limits
    assert np.all((joints >= lower) & (joints <= upper))
    base = planner.base_at(path, joints)
    np.testing.assert_allclose(base[0], 0.0, atol=1e-9)
    ways = np.diff(base, axis=0)
    limits = planner.robot.base
    assert np.linalg.norm(ways[:, :2], axis=1).max() <= limits.max_velocity * SECONDS
    assert np.abs(wrap(ways[:, 2])).max() <= limits.max_rotation * SECONDS
    poses = planar_pose(*base.T)
    assert planner.solver.solve(relative(path, poses), joints).feasible.all()
    if among:
        around = solids.of(np.zeros(len(base), dtype=np.intp))
        assert not collides(planner.solver.collision, joints, poses, around)[:, 0].any()
        straight = planar_pose(*np.linspace([0.0, 0.0, 0.0], base[-1], 100).T)
        held = np.broadcast_to(joints[0], (100, joints.shape[1]))
        crowded = solids.of(np.zeros(100, dtype=np.intp))
        assert collides(planner.solver.collision, held, straight, crowded)[:, 0].any()


def test_there_is_no_path_where_the_ee_leaves_the_reach(planner):
    assert plan(planner, line(planner, 0.0, 0.0, 0.1)) is None
