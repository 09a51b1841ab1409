import fcl
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kinfeas.core.errors import KinfeasError
from kinfeas.core.solids import Solids
from kinfeas.core.spatial import compose, planar_pose, rotation, yaw
from kinfeas.kinematics.base_obstacles import base_obstacles, base_prisms
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.free_space import connected
from kinfeas.kinematics.ik import IkOptions, IkSolver
from kinfeas.kinematics.scans import scan
from kinfeas.kinematics.self_collision import MARGIN, build_collision_model, self_collides
from kinfeas.kinematics.solids import collides, distances, in_base
from kinfeas.robots.loading import load_robot
from tests.builders import at
from tests.kinematics.conftest import Pinocchio, Primitives, draw, touch

BANDS = [(0.0, 0.35), (0.35, 1.5)]


def draw_solids(n, places, reach=2.5, seed=0):
    """Return solids around the world's origin; a tenth of the places is empty."""
    rng = np.random.default_rng(seed)
    solids = Solids.empty(n, places)
    solids.pose[:] = rng.uniform([-reach, -reach, -np.pi], [reach, reach, np.pi], (n, places, 3))
    solids.cylinder[:] = rng.random((n, places)) < 0.4
    half = rng.uniform(0.03, 0.5, (n, places, 2)) * (rng.random((n, places, 1)) < 0.9)
    solids.size[..., 0] = half[..., 0]
    solids.size[..., 1] = np.where(solids.cylinder, half[..., 0], half[..., 1])
    solids.size[..., 2] = rng.uniform(-0.5, 1.0, (n, places)).clip(0.0)
    solids.size[..., 3] = solids.size[..., 2] + rng.uniform(0.02, 1.0, (n, places))
    return solids


def draw_bases(n, seed=0):
    x, y, heading = np.random.default_rng(seed).uniform(-1.0, 1.0, (3, n)) * [[1.0], [1.0], [3.0]]
    return planar_pose(x, y, heading)


def fcl_solids(solids, row):
    found = []
    for (x, y, turn), size, cylinder in zip(
        solids.pose[row], solids.size[row], solids.cylinder[row], strict=True
    ):
        if size[0] > 0.0:
            high = size[3] - size[2]
            shape = fcl.Cylinder(size[0], high) if cylinder else fcl.Box(*2.0 * size[:2], high)
            matrix = Rotation.from_euler("z", turn).as_matrix()
            placement = fcl.Transform(matrix, [x, y, (size[2] + size[3]) / 2.0])
            found.append(fcl.CollisionObject(shape, placement))
    return found


class Among(Primitives):
    def __init__(self, robot, judge):
        super().__init__(robot, judge)
        body = build_collision_model(robot).body
        self.groups = np.flatnonzero(body < 0), np.flatnonzero(body >= 0)

    def touch(self, joint_positions, solids, row):
        """Return whether each group of shapes touches; bounding spheres rule most pairs out."""
        centres, objects = self.place(joint_positions), fcl_solids(solids, row)
        middle = np.array([one.getTranslation() for one in objects]).reshape(-1, 3)
        used = solids.size[row, solids.size[row, :, 0] > 0.0]
        reach = np.linalg.norm([used[:, 0], used[:, 1], (used[:, 3] - used[:, 2]) / 2.0], axis=0)
        near = np.linalg.norm(centres[:, np.newaxis] - middle, axis=2) <= (
            self.radius[:, np.newaxis] + reach
        )
        return [
            any(touch(self.objects[i], objects[k]) for i in group for k in np.flatnonzero(near[i]))
            for group in self.groups
        ]

    def distances(self, joint_positions, solids, row):
        self.place(joint_positions)
        objects = fcl_solids(solids, row)
        return [
            min(
                (fcl.distance(self.objects[i], one) for i in group for one in objects),
                default=np.inf,
            )
            for group in self.groups
        ]


def check(robot, judge, count):
    joints, bases = draw(robot, count), draw_bases(count)
    solids, among = draw_solids(count, 4), Among(robot, judge)
    fast = collides(build_collision_model(robot), joints, bases, solids)
    seen = in_base(solids, bases)
    exact = np.array([among.touch(positions, seen, row) for row, positions in enumerate(joints)])
    assert not np.any(exact & ~fast), "free, but FCL's primitives touch"
    assert np.all(exact.sum(axis=0) > count / 20)
    assert (fast & ~exact).mean() < 0.01  # the margin of 1 mm takes 0.3 %


def test_free_configurations_are_free_for_fcl(robot, judge):
    check(robot, judge, 700)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "count"), [("pr2", 20_000), ("tiago", 40_000), ("hsr", 40_000)])
def test_many_free_configurations_are_free_for_fcl(name, count):
    robot = load_robot(name)
    check(robot, Pinocchio(robot), count)


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


def inside(points, solids, row, low, high):
    """Return which world points (m, 2) are within solids whose heights overlap the band."""
    found = np.zeros(len(points), dtype=np.bool_)
    for (x, y, turn), size, cylinder in zip(
        solids.pose[row], solids.size[row], solids.cylinder[row], strict=True
    ):
        if size[0] > 0.0 and size[2] < high and size[3] > low:
            own = (points - [x, y]) @ Rotation.from_euler("z", turn).as_matrix()[:2, :2]
            within = np.hypot(*own.T) < size[0]
            found |= within if cylinder else np.all(np.abs(own) < size[:2], axis=1)
    return found


def test_beams_end_at_the_first_solid():
    n, beams, longest = 40, 48, 3.0
    solids, bases = draw_solids(n, 8), draw_bases(n)
    ranges = scan(solids, bases, BANDS, beams, longest)
    assert ranges.shape == (n, 2, beams)
    steps = np.linspace(0.0, longest, 1501)
    for row, pose in enumerate(bases):
        angles = yaw(pose) - np.pi + 2.0 * np.pi * np.arange(beams) / beams
        ways = steps[:, np.newaxis] * np.stack([np.cos(angles), np.sin(angles)])[:, np.newaxis]
        points = (pose[:2, np.newaxis, np.newaxis] + ways).reshape(2, -1).T
        for band, (low, high) in enumerate(BANDS):
            hit = inside(points, solids, row, low, high).reshape(len(steps), beams)
            sampled = np.where(hit.any(axis=0), steps[hit.argmax(axis=0)], longest)
            exact = ranges[row, band]
            assert np.all(sampled >= exact - 1e-9)
            # A sample may step over a corner: the middle of the way to it is inside, then.
            entry = pose[:2] + (exact + 1e-6)[:, np.newaxis] * np.stack(
                [np.cos(angles), np.sin(angles)], axis=1
            )
            assert np.all(inside(entry, solids, row, low, high) | (exact == longest))
    assert np.any(ranges == 0.0)
    assert 0.1 < np.mean(ranges == longest) < 0.9


def test_beam_zero_points_backwards_and_bands_are_open_at_touching_solids():
    solids = Solids.empty(1, 2)
    solids.pose[0, :, :2] = [[-1.0, 0.0], [0.0, 1.0]]
    solids.size[0] = [[0.2, 0.3, 0.0, 0.35], [0.2, 0.3, 0.35, 2.0]]
    ranges = scan(solids, at(), BANDS, 4, 5.0)
    np.testing.assert_allclose(ranges[0], [[0.8, 5.0, 5.0, 5.0], [5.0, 5.0, 5.0, 0.7]])


def test_a_wall_within_the_margin_counts_as_touched(hsr):
    model, joints = build_collision_model(hsr), draw(hsr, 2)
    solids = Solids.empty(2, 1)
    front = np.max(model.offset[0, 0] + model.size[0, 0])
    solids.pose[:, 0, 0] = front + 0.1 + MARGIN + np.array([-1e-5, 1e-5])
    solids.size[:, 0] = [0.1, 2.0, 0.0, 0.15]
    found = collides(model, joints, planar_pose(*np.zeros((3, 2))), solids)
    np.testing.assert_array_equal(found[:, 0], [True, False])


def test_ik_finds_solutions_beside_solids(robot):
    solver = IkSolver(robot)
    joints = draw(robot, 400)
    joints = joints[~self_collides(solver.collision, joints)]
    n, seeds = len(joints), np.random.default_rng(0).permutation(joints)
    solids, targets = draw_solids(n, 6), forward(solver.chain, joints)

    def touching(positions):
        origin = planar_pose(*np.zeros((3, n)))
        return collides(solver.collision, positions, origin, solids)[:, 1]

    found, blind = solver.solve(targets, seeds, solids=solids), solver.solve(targets, seeds)
    assert touching(blind.joint_positions).mean() > 0.05
    assert not touching(found.joint_positions)[found.feasible].any()
    assert not self_collides(solver.collision, found.joint_positions[found.feasible]).any()
    assert found.feasible[~touching(joints)].mean() > 0.95
    some = np.arange(5, 9)
    part = solver.solve(targets[some], seeds[some], solids=solids.of(some))
    np.testing.assert_array_equal(part.joint_positions, found.joint_positions[some])
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
    origin, step = planar_pose(*np.zeros((3, len(joints)))), 0.1 * robot.max_joint_velocity

    def kept(**rules):
        found = solver.solve(targets, joints, step, solids=solids, **rules)
        gap = distances(solver.collision, found.joint_positions, origin, solids)[:, 1]
        return gap[found.feasible]

    strict, free = kept(allow_reconfiguration=False), kept()
    assert strict.min() > clearance
    assert free.min() > 0.0
    assert free.min() < clearance < np.median(free)
    assert len(strict) < len(free)


def test_distances_are_those_of_fcl(robot, judge):
    n = 60
    joints, bases, solids = draw(robot, n), draw_bases(n), draw_solids(n, 3, reach=4.0)
    model, among, seen = build_collision_model(robot), Among(robot, judge), in_base(solids, bases)
    found = distances(model, joints, bases, solids)
    exact = [among.distances(positions, seen, row) for row, positions in enumerate(joints)]
    exact = np.array(exact).clip(0.0)  # FCL returns -1 in contact
    np.testing.assert_allclose(found, exact, atol=2e-5)
    assert np.any(found == 0.0) and np.any(found > 0.5)
    touching = collides(model, joints, bases, solids)
    np.testing.assert_array_equal(touching, found < MARGIN)
    assert np.all(distances(model, joints, bases, Solids.empty(n, 2)) == np.inf)


def test_base_obstacles_are_nearest_points(hsr):
    """HSR's base has upright shapes only: for solids as high as the room they are exact."""
    model, n = build_collision_model(hsr), 300
    bases, solids, joints = draw_bases(n), draw_solids(n, 1), draw(hsr, n)
    solids.size[:, :, 2:] = [0.0, 3.0]
    near = base_obstacles(base_prisms(model), bases, solids, 1.0)
    exact = distances(model, joints, bases, solids)[:, 0]
    nearest = near.distance.min(axis=1)
    free = (exact > 0.0) & (exact < 1.0)
    assert free.sum() > 50
    np.testing.assert_allclose(nearest[free], exact[free], atol=1e-6)
    assert np.all(nearest[exact >= 1.0] == np.inf)
    first = near.distance.argmin(axis=1)[:, np.newaxis, np.newaxis]
    normal = np.take_along_axis(near.normal, first, axis=1)[:, 0]
    np.testing.assert_allclose(np.linalg.norm(normal[free], axis=1), 1.0)
    step = np.zeros((n, 7))
    step[:, :2], step[:, 6] = 1e-4 * normal, 1.0
    closer = distances(model, joints, compose(bases, step), solids)[:, 0]
    np.testing.assert_allclose(exact[free] - closer[free], 1e-4, atol=1e-6)


def test_closing_speeds_are_those_at_which_distances_shrink(hsr):
    model, n, dt = build_collision_model(hsr), 100, 1e-5
    bases, solids = draw_bases(n), draw_solids(n, 1)
    solids.size[:, :, 2:] = [0.0, 3.0]
    solids.velocity[:], solids.span[:] = np.random.default_rng(0).normal(size=(n, 1, 2)), 9.0
    near, later = (
        base_obstacles(base_prisms(model), bases, solids.at(np.full(n, seconds)), 9.0)
        for seconds in (0.0, dt)
    )
    one, other = near.distance.min(axis=1), later.distance.min(axis=1)
    first = near.distance.argmin(axis=1)[:, np.newaxis]
    speed = np.take_along_axis(near.closing_speed, first, axis=1)[:, 0]
    known = (one > 1e-3) & np.isfinite(one)
    assert known.sum() > 50
    np.testing.assert_allclose(speed[known], (one[known] - other[known]) / dt, atol=1e-3)


def test_a_parallel_wall_has_the_corners_of_the_base(pr2):
    model, wall = build_collision_model(pr2), Solids.empty(1, 1)
    front = model.offset[0, 0] + model.size[0, 0]
    wall.pose[0, 0, 0], wall.size[0, 0] = front + 0.3, [0.1, 2.0, 0.0, 0.2]
    found = base_obstacles(base_prisms(model), at(), wall, 1.0)
    points = found.closest_point[0, np.isfinite(found.distance[0])]
    np.testing.assert_allclose(found.distance.min(), 0.2, atol=1e-9)
    assert {tuple(point.round(3)) for point in points} == {
        (round(front, 3), side) for side in model.size[0, 1].round(3) * np.array([-1.0, 1.0])
    }
    np.testing.assert_allclose(found.normal[0], [[1.0, 0.0]] * len(points), atol=1e-12)
    wall.size[0, 0, 2:] = [1.5, 2.0]
    above = base_obstacles(base_prisms(model), at(), wall, 1.0)
    assert above.distance.size == 0
    wall.pose[0, 0, 0], wall.size[0, 0, 2:] = front + 0.05, [0.0, 0.2]
    np.testing.assert_allclose(
        base_obstacles(base_prisms(model), at(), wall, 1.0).distance.min(), -0.05
    )


START, BEYOND, BESIDE = np.zeros(2), [3.0, 0.0], [0.0, 3.0]


def fence(gap):
    """Return walls around a square of 4 m, with a gap on the side towards x."""
    half, solids = (4.0 - gap) / 4.0, Solids.empty(1, 5)
    side = gap / 2.0 + half
    solids.pose[0, :, :2] = [[2, side], [2, -side], [-2, 0], [0, 2], [0, -2]]
    solids.size[0] = [*[[0.05, half, 0, 1]] * 2, [0.05, 2, 0, 1], *[[2, 0.05, 0, 1]] * 2]
    return solids


@pytest.mark.parametrize(("gap", "open_"), [(1.2, True), (0.5, False), (0.0, False)])
def test_a_disc_passes_gaps_that_are_wide_enough(gap, open_):
    places = np.array([BEYOND, BESIDE, [1.0, 1.0]])
    reached = connected(fence(gap), START, places, (0.4, 0.0))
    np.testing.assert_array_equal(reached, [open_, open_, True])


def test_solids_above_a_disc_do_not_block_it():
    solids = fence(0.0)
    solids.size[..., 2] = 0.5
    assert connected(solids, START, np.array([BEYOND]), (0.4, 0.0)).all()
