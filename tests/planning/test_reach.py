from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kinfeas.core.solids import Solids
from kinfeas.core.spatial import compose, distance, make_pose
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import spread_configurations
from kinfeas.kinematics.solids import collides
from kinfeas.planning.reach import BasePlacer
from kinfeas.robots.loading import load_robot

AHEAD = np.array([1.0, 0.0, 0.8, 0.0, 0.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def of_pr2(pr2):
    return BasePlacer(pr2)


def boxes(*lines):
    """Return boxes of x, y, their half extents, lowest and highest z, metres."""
    return Solids.from_table(np.array([[x, y, 0, *size, *[0] * 4] for x, y, *size in lines]))


def poses(count):
    rng = np.random.default_rng(1)
    position = rng.uniform([-2.0, -2.0, 0.3], [2.0, 2.0, 1.2], (count, 3))
    return make_pose(position, Rotation.random(count, rng=rng))


def test_base_poses_reach_and_are_free_with_the_best_first(robot):
    placer = BasePlacer(robot)
    high = [-1, 1, 0.2, 0.5, 0, 1.5]
    solids = boxes([0.5, 0, 0.3, 0.3, 0, 0.7], high, [1, 0.8, 0.3, 0.1, 0, 0.6])
    options, reached = placer.solver.options, 0
    for goal in poses(12):
        placement = placer.place(goal, solids, count=5)
        reached += placement.reachable
        ee = compose(placement.base_pose, forward(placer.solver.chain, placement.joint_positions))
        metres, radians = distance(ee, np.broadcast_to(goal, ee.shape))
        assert (metres <= options.position_tolerance).all()
        assert (radians <= options.rotation_tolerance).all()
        for base, joints, clearance in zip(
            placement.base_pose, placement.joint_positions, placement.clearance, strict=True
        ):
            grown = solids.wider(clearance, clearance)
            shapes = placer.solver.collision, joints[np.newaxis], base[np.newaxis]
            assert not collides(*shapes, grown).any()
            assert placer.solver.admissible(joints)
        assert (np.diff(placement.margin) <= 0.0).all()
        again = placer.place(goal, solids, count=64)
        np.testing.assert_array_equal(again.base_pose[:5], placement.base_pose)
    assert reached >= 8


TABLE, WALLED_IN = [1.0, 0.0, 0.5, 0.5, 0.7, 0.9], ([3.0, 0.0, 0.05, 99.0, 0.0, 1.0],)


@pytest.mark.parametrize(("limit", "height", "rpy", "solids", "places"), [
    ("height", 2.4, (0, 0, 0), (), ()), ("floor", -0.4, (0, 0, 0), (), ()),
    ("orientation", 0.1, (0, -1.5, 0), (), ()),
    ("solids", 0.8, (0, 0, 0), ([9, 9, 1, 1, 0, 1], TABLE), (1,)),
    ("path", 0.8, (0, 0, 0), WALLED_IN, ()), ("", 0.8, (0, 0, 0), ([3, 0, 0.05, 9, 0, 1],), ()),
    ("", 0.8, (0, 0, 0), ([9, 9, 1, 1, 0, 1],), ()),
])  # fmt: skip
def test_the_reason_is_named(of_pr2, limit, height, rpy, solids, places):
    goal = make_pose(np.array([1.0, 0.0, height]), Rotation.from_euler("xyz", rpy))
    start = np.array([5.5, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    placement = of_pr2.place(goal, boxes(*solids) if solids else None, start)
    assert (placement.limit, placement.solids) == (limit, places)
    assert placement.reachable == (not limit)
    if limit == "height":
        assert placement.heights[0] >= 0.0
        assert not placement.heights[0] <= height <= placement.heights[1]
        assert f"{placement.heights[1]:.2f} m" in placement.reason


def test_motors_that_hold_nothing_reach_nothing():
    weak = BasePlacer(
        replace(load_robot("tiago"), max_gravity_load=1e-3, counterbalanced=frozenset())
    )
    assert weak.place(AHEAD).limit == "torque"


def test_one_base_pose_for_several_ee_poses(of_pr2):
    goals = np.stack([AHEAD, AHEAD + np.array([0.2, 0.2, 0.1, 0, 0, 0, 0])])
    placement = of_pr2.place_for_all(goals)
    assert placement.joint_positions.shape == (8, 2, len(of_pr2.solver.robot.arm))
    ee = forward(of_pr2.solver.chain, placement.joint_positions)
    reached = compose(placement.base_pose[:, np.newaxis].repeat(2, axis=1), ee)
    assert distance(reached, np.broadcast_to(goals, reached.shape))[0].max() < 1e-3
    for axis, limit in ((0, "motion"), (2, "height")):
        goals[1, axis] += 4.0
        assert of_pr2.place_for_all(goals).limit == limit


def test_a_base_pose_for_several_ee_poses_is_found_if_there_is_one(of_pr2):
    solver = of_pr2.solver
    joints = spread_configurations(solver.robot, 400, seed=2)
    goals = forward(solver.chain, joints[solver.admissible(joints)])
    goals = goals[goals[:, 2] > 0.0][:160].reshape(20, 8, 7)
    assert sum(of_pr2.place_for_all(every).reachable for every in goals) >= 18
