from dataclasses import replace
from itertools import combinations, pairwise

import fcl
import numpy as np
import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import rotation
from kinfeas.kinematics.self_collision import (
    build_collision_model,
    checked_links,
    self_collides,
)
from tests.kinematics.conftest import draw


class Solids:
    """FCL's primitives of a robot, placed by Pinocchio, and the checked pairs."""

    def __init__(self, robot, judge):
        self.judge = judge
        self.shapes = [
            (link.name, shape) for link in robot.urdf.links.values() for shape in link.shapes
        ]
        kinds = {"box": fcl.Box, "cylinder": fcl.Cylinder, "sphere": fcl.Sphere}
        self.solids = [
            fcl.CollisionObject(kinds[shape.kind](*shape.size)) for _, shape in self.shapes
        ]
        checked = {frozenset(pair) for pair in checked_links(robot)}
        self.pairs = np.array(
            [
                pair
                for pair in combinations(range(len(self.shapes)), 2)
                if frozenset(self.shapes[i][0] for i in pair) in checked
            ]
        )
        self.radius = np.array([_radius(shape) for _, shape in self.shapes])

    def touch(self, joint_positions):
        """Return whether any pair touches; bounding spheres rule most of them out."""
        self.judge.place(joint_positions)
        centres = np.empty((len(self.shapes), 3))
        for i, (link, shape) in enumerate(self.shapes):
            turn, position = self.judge.link(link)
            centres[i] = position + turn @ shape.pose[:3]
            placement = fcl.Transform(turn @ rotation(shape.pose).as_matrix(), centres[i])
            self.solids[i].setTransform(placement)
        a, b = self.pairs.T
        gaps = np.linalg.norm(centres[a] - centres[b], axis=1) - self.radius[a] - self.radius[b]
        return any(self._collide(i, k) for i, k in self.pairs[gaps <= 0.0])

    def _collide(self, i, k):
        request, result = fcl.CollisionRequest(), fcl.CollisionResult()
        return fcl.collide(self.solids[i], self.solids[k], request, result) > 0


def _radius(shape):
    x = np.array(shape.size)
    sizes = {"box": x / 2.0, "cylinder": x / [1.0, 2.0] if len(x) == 2 else x, "sphere": x}
    return np.linalg.norm(sizes[shape.kind])


def compare(robot, judge, count):
    """Return how many configurations are free, touching and needlessly rejected."""
    joints, solids = draw(robot, count), Solids(robot, judge)
    fast = self_collides(build_collision_model(robot), joints)
    exact = np.array([solids.touch(positions) for positions in joints])
    assert not np.any(exact & ~fast), "free, but FCL's primitives touch"
    return np.sum(~exact & ~fast), np.sum(exact & fast), np.sum(fast & ~exact)


def test_free_configurations_are_free_for_fcl(robot, judge):
    free, touching, needless = compare(robot, judge, 1500)
    assert needless / (free + needless) < 0.01  # the margin of 1 mm takes about 0.1 %
    assert touching > 15
    homes = np.array(list(robot.home.values()))
    assert not np.any(self_collides(build_collision_model(robot), homes))


def test_mimic_joints_carry_their_shapes(odd_robot, odd_judge):
    free, touching, _ = compare(odd_robot, odd_judge, 1000)
    assert free > 100
    assert touching > 10


def test_chains_of_links_may_be_long(odd_robot):
    urdf, hand = odd_robot.urdf, odd_robot.ee_frame
    mount = next(joint for joint in urdf.joints.values() if joint.kind == "fixed")
    ends = [hand, *(f"frame_{i}" for i in range(1500))]
    links = {name: replace(urdf.links[hand], name=name, shapes=()) for name in ends[1:]}
    joints = {
        child: replace(mount, name=child, parent=parent, child=child)
        for parent, child in pairwise(ends)
    }
    deep = replace(urdf, links=urdf.links | links, joints=urdf.joints | joints)
    pairs = build_collision_model(replace(odd_robot, urdf=deep)).pairs
    np.testing.assert_array_equal(pairs, build_collision_model(odd_robot).pairs)


def test_checked_pairs_are_those_that_the_arm_moves_less_adjacent_ones(robot, judge):
    rigid = _constant_to(robot, judge, draw(robot, 5))
    joined = {
        frozenset(_rigid_root(robot, link) for link in (joint.parent, joint.child))
        for joint in robot.urdf.joints.values()
    }
    expected = [
        (a, b)
        for a, b in combinations(sorted(robot.urdf.links), 2)
        if robot.urdf.links[a].shapes
        and robot.urdf.links[b].shapes
        and not rigid(a, b)
        and frozenset((_rigid_root(robot, a), _rigid_root(robot, b))) not in joined
        and frozenset((a, b)) not in robot.ignored_collisions
    ]
    assert checked_links(robot) == expected


def _constant_to(robot, judge, joints):
    """Return a function: is the relative pose of two links constant?"""
    poses = {name: [] for name in robot.urdf.links}
    for positions in joints:
        judge.place(positions)
        for name, found in poses.items():
            turn, position = judge.link(name)
            matrix = np.eye(4)
            matrix[:3, :3], matrix[:3, 3] = turn, position
            found.append(matrix)
    stacked = {name: np.array(found) for name, found in poses.items()}

    def constant(a, b):
        between = np.linalg.inv(stacked[a]) @ stacked[b]
        return bool(np.abs(between - between[0]).max() < 1e-9)

    return constant


def _rigid_root(robot, link):
    for joint in reversed(robot.urdf.path_to(link)):
        if joint.kind != "fixed":
            return joint.child
    return robot.urdf.root


def test_rows_do_not_depend_on_the_batch(odd_robot):
    model, joints = build_collision_model(odd_robot), draw(odd_robot, 300)
    together = self_collides(model, joints)
    assert 0 < together.sum() < 300
    one_by_one = [bool(self_collides(model, positions)) for positions in joints]
    np.testing.assert_array_equal(together, one_by_one)
    folded = self_collides(model, joints.reshape(2, 150, -1))
    np.testing.assert_array_equal(folded, together.reshape(2, 150))
    assert self_collides(model, joints[:0]).shape == (0,)
    for shape in ((2,), (), (5, 99)):
        with pytest.raises(KinfeasError, match="joint positions"):
            self_collides(model, np.zeros(shape))


def test_free_configurations_keep_the_margin(odd_robot, odd_judge):
    model, solids = build_collision_model(odd_robot), Solids(odd_robot, odd_judge)
    joints = draw(odd_robot, 2000, seed=1)
    closest = np.inf
    for positions in joints[~self_collides(model, joints)][:150]:
        solids.touch(positions)
        for i, k in solids.pairs:
            request, result = fcl.DistanceRequest(), fcl.DistanceResult()
            gap = fcl.distance(solids.solids[i], solids.solids[k], request, result)
            closest = min(closest, gap)
    assert closest > 1e-3 - 1e-5
