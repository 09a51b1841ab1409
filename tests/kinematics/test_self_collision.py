from itertools import combinations

import fcl
import numpy as np

from kinfeas.kinematics.self_collision import build_collision_model, checked_links, self_collides
from tests.kinematics.conftest import Primitives, draw, touch


class Pairs(Primitives):
    def __init__(self, robot, judge):
        super().__init__(robot, judge)
        checked = {frozenset(pair) for pair in checked_links(robot)}
        links = [link for link, _ in self.shapes]
        pairs = combinations(range(len(links)), 2)
        self.pairs = np.array([(i, k) for i, k in pairs if {links[i], links[k]} in checked])
        carried = frozenset().union(*(robot.urdf.below(joint.name) for joint in robot.arm))
        self.carried = [i for i, link in enumerate(links) if link in carried]
        below = fcl.Transform(np.array([0.0, 0.0, -5.0]))
        self.floor = fcl.CollisionObject(fcl.Box(20.0, 20.0, 10.0), below)

    def touch(self, joint_positions):
        """Return whether any pair or the floor touches; bounding spheres rule most of them out."""
        centres = self.place(joint_positions)
        low = [i for i in self.carried if centres[i, 2] < self.radius[i]]
        if any(touch(self.objects[i], self.floor) for i in low):
            return True
        a, b = self.pairs.T
        gaps = np.linalg.norm(centres[a] - centres[b], axis=1) - self.radius[a] - self.radius[b]
        return any(touch(self.objects[i], self.objects[k]) for i, k in self.pairs[gaps <= 0.0])


def compare(robot, judge, count):
    """Return how many configurations are free, touching and needlessly rejected."""
    joints, pairs = draw(robot, count), Pairs(robot, judge)
    fast = self_collides(build_collision_model(robot), joints)
    exact = np.array([pairs.touch(positions) for positions in joints])
    assert not np.any(exact & ~fast), "free, but FCL's primitives touch"
    return np.sum(~exact & ~fast), np.sum(exact & fast), np.sum(fast & ~exact)


def test_free_configurations_are_free_for_fcl(robot, judge):
    free, touching, needless = compare(robot, judge, 600)
    assert needless / (free + needless) < 0.01  # the margin of 1 mm takes about 0.1 %
    assert touching > 5
    homes = np.array(list(robot.home.values()))
    assert not np.any(self_collides(build_collision_model(robot), homes))


def test_mimic_joints_carry_their_shapes(odd_robot, odd_judge):
    free, touching, _ = compare(odd_robot, odd_judge, 500)
    assert free > 50
    assert touching > 5


def test_checked_pairs_are_those_that_the_arm_moves_less_adjacent_ones(robot, judge):
    links = sorted(name for name, link in robot.urdf.links.items() if link.shapes)
    poses = {name: [] for name in links}
    for positions in draw(robot, 5):
        judge.place(positions)
        for name in links:
            turn, position = judge.link(name)
            poses[name].append(np.block([[turn, position[:, np.newaxis]], [np.zeros(3), 1.0]]))
    rigid = robot.urdf.rigid
    joined = {frozenset((rigid[j.parent], rigid[j.child])) for j in robot.urdf.joints.values()}
    expected = []
    for a, b in combinations(links, 2):
        between = np.linalg.inv(poses[a]) @ np.array(poses[b])
        moves = np.abs(between - between[0]).max() > 1e-9
        allowed = frozenset((a, b)) in robot.ignored_collisions
        if moves and not allowed and frozenset((rigid[a], rigid[b])) not in joined:
            expected.append((a, b))
    assert checked_links(robot) == expected
