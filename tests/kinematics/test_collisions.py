from itertools import combinations, product

import coal
import numpy as np
import pinocchio
import pytest
from scipy.spatial.transform import Rotation

from kinfeas.core.errors import KinfeasError
from kinfeas.core.solids import Solids
from kinfeas.core.spatial import planar_pose, rotation
from kinfeas.kinematics.convex import BOX, CYLINDER, SCRATCH_ROWS, SPHERE, closer_than
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkOptions, IkSolver
from kinfeas.kinematics.self_collision import (
    MARGIN,
    build_collision_model,
    checked_links,
    self_collides,
)
from kinfeas.kinematics.solids import base_collides, collides, in_base
from tests.kinematics.conftest import Among, Shapes, draw, draw_bases, draw_solids
from tests.kinematics.conftest import apart as distance


def pairs_of(robot):
    """Return the shapes of a robot, the floor and the pairs that may not touch."""
    shapes = Shapes(robot)
    links, model = shapes.links, shapes.model
    checked = {frozenset(pair) for pair in checked_links(robot)}
    carried = frozenset().union(*(robot.urdf.below(joint.name) for joint in robot.arm))
    below = pinocchio.SE3(np.eye(3), np.array([0.0, 0.0, -5.0]))
    floor = pinocchio.GeometryObject("floor", 0, below, coal.Box(20.0, 20.0, 10.0))
    floor = model.addGeometryObject(floor)
    for i, k in combinations(range(len(links)), 2):
        if {links[i], links[k]} in checked:
            model.addCollisionPair(pinocchio.CollisionPair(i, k))
    for i, link in enumerate(links):
        if link in carried:
            model.addCollisionPair(pinocchio.CollisionPair(i, floor))
    return shapes


def test_free_configurations_are_free_for_coal(robot):
    joints, pairs, model = draw(robot, 600), pairs_of(robot), build_collision_model(robot)
    fast = self_collides(model, joints)
    exact = np.array([pairs.collide(positions) for positions in joints])
    assert not np.any(exact & ~fast), "free, but Coal's shapes touch"
    assert np.sum(fast & ~exact) < 0.01 * np.sum(~exact)  # the margin of 1 mm takes about 0.1 %
    assert exact.sum() > 5
    assert not np.any(self_collides(model, np.array(list(robot.home.values()))))


def test_checked_pairs_are_those_that_the_arm_moves_less_adjacent_ones(robot, judge):
    links = sorted(name for name, link in robot.urdf.links.items() if link.shapes)
    poses = {name: [] for name in links}
    for positions in draw(robot, 5):
        judge.place(positions)
        for name in links:
            poses[name].append(judge.data.oMf[judge.model.getFrameId(name)].homogeneous)
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


def test_robots_free_of_solids_are_free_for_coal(robot):
    count = 400
    joints, bases = draw(robot, count), draw_bases(count)
    solids, among = draw_solids(count, 4), Among(robot)
    fast = collides(build_collision_model(robot), joints, bases, solids)
    seen = in_base(solids, bases)
    away = [among.distances(positions, seen, row) for row, positions in enumerate(joints)]
    exact = np.array(away) <= 0.0
    assert not np.any(exact & ~fast), "free, but Coal's shapes touch"
    assert np.all(exact.sum(axis=0) > 10)
    assert (fast & ~exact).mean() < 0.01  # the margin of 1 mm takes 0.3 %
    base = base_collides(build_collision_model(robot), bases, solids)
    np.testing.assert_array_equal(base, fast[:, 0])


def test_gaps_are_those_of_clamped_points():
    solids, points = draw_solids(30, 6), np.random.default_rng(3).uniform(-2.5, 2.5, (30, 20, 3))
    planar, vertical = solids.gaps(points)
    for row, k in zip(*np.nonzero(solids.filled), strict=True):
        (x, y, angle), (a, b, low, high) = solids.pose[row, k], solids.size[row, k]
        local = Rotation.from_euler("z", -angle).apply(points[row] - [x, y, 0.0])
        nearest = np.clip(local, [-a, -b, low], [a, b, high])
        if solids.cylinder[row, k]:
            radius = np.linalg.norm(local[:, :2], axis=1, keepdims=True)
            nearest[:, :2] = local[:, :2] * np.minimum(a / radius, 1.0)
        away = local - nearest
        np.testing.assert_allclose(planar[row, :, k], np.hypot(*away[:, :2].T), atol=1e-12)
        np.testing.assert_allclose(vertical[row, :, k], np.abs(away[:, 2]), atol=1e-12)


def test_swept_solids_contain_those_that_move():
    solids, rng = draw_solids(30, 6), np.random.default_rng(4)
    solids.velocity[:], solids.span[:] = rng.uniform(-0.3, 0.3, (30, 6, 2)), 9.0
    points = solids.centre[..., :3] + 0.3 * rng.normal(size=(30, 6, 3))
    swept = np.hypot(*solids.swept(0.0, 2.0).gaps(points))
    for seconds in (0.0, 0.7, 2.0):
        assert np.all(swept <= np.hypot(*solids.at(np.full(30, seconds)).gaps(points)) + 1e-9)


def test_world_and_base_see_the_same_scene():
    solids, bases = draw_solids(20, 8), draw_bases(20)
    solids.velocity[:] = np.random.default_rng(1).uniform(-0.2, 0.2, solids.velocity.shape)
    solids.span[:] = 0.5
    seconds = np.linspace(0.0, 9.0, 20)
    there, back = in_base(solids, bases).at(seconds), in_base(solids.at(seconds), bases)
    np.testing.assert_allclose(there.pose, back.pose, atol=1e-12)
    turn = rotation(bases).as_matrix()[:, :2, :2]
    world = np.einsum("nij,nkj->nki", turn, back.pose[:, :, :2]) + bases[:, np.newaxis, :2]
    np.testing.assert_allclose(world, solids.at(seconds).pose[:, :, :2], atol=1e-12)


def test_a_wall_within_the_margin_counts_as_touched(hsr):
    model, joints = build_collision_model(hsr), draw(hsr, 2)
    solids = Solids.empty(2, 1)
    front = np.max(model.offset[0, 0] + model.size[0, 0])
    solids.pose[:, 0, 0] = front + 0.1 + MARGIN + np.array([-1e-5, 1e-5])
    solids.size[:, 0] = [0.1, 2.0, 0.0, 0.15]
    result = collides(model, joints, planar_pose(*np.zeros((3, 2))), solids)
    np.testing.assert_array_equal(result[:, 0], [True, False])


def test_ik_finds_solutions_beside_solids(robot):
    solver = IkSolver(robot)
    joints = draw(robot, 400)
    joints = joints[~self_collides(solver.collision, joints)]
    n, seeds = len(joints), np.random.default_rng(0).permutation(joints)
    solids, targets = draw_solids(n, 6), forward(solver.chain, joints)

    def touching(positions):
        origin = planar_pose(*np.zeros((3, n)))
        return collides(solver.collision, positions, origin, solids)[:, 1]

    result, blind = solver.solve(targets, seeds, solids=solids), solver.solve(targets, seeds)
    assert touching(blind.joint_positions).mean() > 0.05
    assert not touching(result.joint_positions)[result.feasible].any()
    assert not self_collides(solver.collision, result.joint_positions[result.feasible]).any()
    assert result.feasible[~touching(joints)].mean() > 0.95
    some = np.arange(5, 9)
    part = solver.solve(targets[some], seeds[some], solids=solids.of(some))
    np.testing.assert_array_equal(part.joint_positions, result.joint_positions[some])
    for places in (0, 3):
        nothing = solver.solve(targets, seeds, solids=Solids.empty(n, places))
        np.testing.assert_array_equal(nothing.joint_positions, blind.joint_positions)
    with pytest.raises(KinfeasError, match="solids"):
        solver.solve(targets, seeds, solids=solids.of(some))


def test_arms_keep_the_clearance_unless_they_may_be_reconfigured(robot):
    solver, clearance = IkSolver(robot, IkOptions(solid_clearance=0.03)), 0.03
    joints = draw(robot, 300)
    joints = joints[~self_collides(solver.collision, joints)]
    solids, targets = draw_solids(len(joints), 6), forward(solver.chain, joints)
    among, step = Among(robot), 0.1 * robot.max_joint_velocity

    def kept(**rules):
        arm = solver.solve(targets, joints, step, solids=solids, **rules)
        rows = np.flatnonzero(arm.feasible)
        return np.array([among.distances(arm.joint_positions[i], solids, i)[1] for i in rows])

    strict, free = kept(allow_reconfiguration=False), kept()
    assert strict.min() > clearance
    assert free.min() > 0.0
    assert free.min() < clearance < np.median(free)
    assert len(strict) < len(free)


SETTLED = 1e-5  # m beyond the margin, where the answer must be exact

PAIRS = list(product((BOX, CYLINDER, SPHERE), repeat=2))


class Solid:
    def __init__(self, kind, size, turn, position):
        size, position = np.array(size, dtype=float), np.array(position, dtype=float)
        x, y, z = size
        shapes = {BOX: coal.Box(2 * x, 2 * y, 2 * z), CYLINDER: coal.Cylinder(x, 2 * z)}
        self.kernel, self.size = (kind, size, turn, position), size
        self.turn, self.position = turn, position
        self.placed = shapes.get(kind, coal.Sphere(x)), coal.Transform3s(turn, position)

    def at(self, position):
        return Solid(*self.kernel[:3], position)


def random_solid(rng, kind):
    """Return any solid; a quarter of them are needles, plates and dust."""
    a, b, c = rng.uniform(0.01, 0.5, 3)
    if rng.random() < 0.25:
        a, b, c = rng.choice([1e-3, 1.0], 3)
    size = {BOX: (a, b, c), CYLINDER: (a, a, c), SPHERE: (a, a, a)}[kind]
    return Solid(kind, size, Rotation.random(rng=rng).as_matrix(), rng.uniform(-1.0, 1.0, 3))


def near(a, b):
    return closer_than(MARGIN, *a.kernel, *b.kernel, np.empty((SCRATCH_ROWS, 3)))


def collide(a, b):
    return distance(*a.placed, *b.placed)[0] <= 0.0


def apart(rng, a, b, gap):
    """Return `b` shifted so that it is `gap` metres away from `a`.

    A shift along the line through the nearest points changes the distance by its length.
    """
    direction = rng.normal(size=3)
    far = b.at(a.position + 5.0 * direction / np.linalg.norm(direction))
    metres, start, end = distance(*a.placed, *far.placed)
    return far.at(far.position + (start - end) * (1.0 - gap / metres))


@pytest.mark.parametrize(("first", "second"), PAIRS)
def test_the_distance_decides_near_the_margin(first, second):
    rng = np.random.default_rng(1)
    gaps = [0.0, 2e-4, 9e-4, MARGIN - SETTLED, MARGIN + SETTLED, 1.2e-3, 5e-3, 0.1, 1.0]
    for i in range(300):
        a, b = random_solid(rng, first), random_solid(rng, second)
        gap = gaps[i % len(gaps)]
        b = apart(rng, a, b, gap)
        assert near(a, b) == near(b, a) == (gap < MARGIN), gap
        inside = a.at(b.position + rng.uniform(-1.0, 1.0, 3) * min(b.size) / 2.0)
        assert near(inside, b)


@pytest.mark.parametrize(("first", "second"), PAIRS)
@pytest.mark.parametrize("gap", [-0.2, -1e-4, 0.0, 5e-4, 1.1e-3, 2e-3, 0.3])
def test_parallel_faces(first, second, gap):
    rng = np.random.default_rng(3)
    world = Rotation.random(rng=rng).as_matrix()
    sizes = {BOX: (0.3, 0.2, 0.25), CYLINDER: (0.2, 0.2, 0.3), SPHERE: (0.22, 0.22, 0.22)}
    for axis, sideways in product(range(3), (0.0, 0.05, 0.15)):
        a = Solid(first, sizes[first], world, np.zeros(3))
        offset = np.full(3, sideways)
        offset[axis] = a.size[axis] + sizes[second][axis] + gap
        b = Solid(second, sizes[second], world, world @ offset)
        if collide(a, b):
            assert near(a, b)
        # Beside the middle of a round side the gap is larger.
        if sideways == 0.0 or BOX == first == second:
            assert near(a, b) == near(b, a) == (gap < MARGIN)
