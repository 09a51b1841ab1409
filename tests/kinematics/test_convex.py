from itertools import product

import fcl
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kinfeas.kinematics.convex import BOX, CYLINDER, SCRATCH_ROWS, SPHERE, closer_than

MARGIN = 1e-3
SETTLED = 1e-5  # m beyond the margin, where the answer must be exact

KINDS = {BOX: "box", CYLINDER: "cylinder", SPHERE: "sphere"}
PAIRS = [pytest.param(*pair, id="-".join(KINDS[k] for k in pair)) for pair in product(KINDS, KINDS)]


class Solid:
    def __init__(self, kind, size, turn, position):
        self.kind, self.size, self.turn = kind, np.array(size, dtype=float), turn
        self.position = np.array(position, dtype=float)
        x, y, z = self.size
        if kind == BOX:
            self.geometry = fcl.Box(2.0 * x, 2.0 * y, 2.0 * z)
        elif kind == CYLINDER:
            self.geometry = fcl.Cylinder(x, 2.0 * z)
        else:
            self.geometry = fcl.Sphere(x)

    def at(self, position):
        return Solid(self.kind, self.size, self.turn, position)

    @property
    def fcl(self):
        return fcl.CollisionObject(self.geometry, fcl.Transform(self.turn, self.position))

    @property
    def kernel(self):
        return self.kind, self.size, self.turn, self.position


def random_solid(rng, kind, largest=0.5):
    a, b, c = rng.uniform(0.01, largest, 3)
    size = {BOX: (a, b, c), CYLINDER: (a, a, c), SPHERE: (a, a, a)}[kind]
    return Solid(kind, size, Rotation.random(rng=rng).as_matrix(), rng.uniform(-1.0, 1.0, 3))


def near(a, b):
    return closer_than(MARGIN, *a.kernel, *b.kernel, np.empty((SCRATCH_ROWS, 3)))


def collide(a, b):
    return fcl.collide(a.fcl, b.fcl, fcl.CollisionRequest(), fcl.CollisionResult()) > 0


def apart(rng, a, b, gap):
    """Return `b` shifted so that it is `gap` metres away from `a`.

    A shift along the line through the nearest points changes the distance by its length.
    """
    direction = rng.normal(size=3)
    far = b.at(a.position + 5.0 * direction / np.linalg.norm(direction))
    result = fcl.DistanceResult()
    request = fcl.DistanceRequest(enable_nearest_points=True)
    distance = fcl.distance(a.fcl, far.fcl, request, result)
    start, end = result.nearest_points
    np.testing.assert_allclose(np.linalg.norm(end - start), distance, atol=1e-5)
    return far.at(far.position + (start - end) * (1.0 - gap / distance))


def test_contacts_of_fcl_are_never_missed_in_any_order():
    rng, touching = np.random.default_rng(0), 0
    for first, second in product(KINDS, KINDS):
        for _ in range(300):
            a, b = random_solid(rng, first), random_solid(rng, second)
            tiny = Solid(second, np.full(3, min(a.size) / 10.0), b.turn, a.position)
            assert near(a, tiny.at(a.position + rng.uniform(-0.4, 0.4, 3) * min(a.size)))
            b = b.at(a.position + rng.normal(scale=0.3, size=3))
            assert near(a, b) == near(b, a)
            if collide(a, b):
                touching += 1
                assert near(a, b)
    assert touching > 1000


@pytest.mark.parametrize(("first", "second"), PAIRS)
def test_the_distance_decides_near_the_margin(first, second):
    rng = np.random.default_rng(1)
    gaps = [0.0, 2e-4, 9e-4, MARGIN - SETTLED, MARGIN + SETTLED, 1.2e-3, 5e-3, 0.1, 1.0]
    for i in range(300):
        a, b = random_solid(rng, first), random_solid(rng, second)
        gap = gaps[i % len(gaps)]
        assert near(a, apart(rng, a, b, gap)) == (gap < MARGIN), gap


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


def test_needles_plates_and_dust():
    rng = np.random.default_rng(4)
    sizes = {
        BOX: [(1.0, 1e-3, 1e-3), (1.0, 1.0, 1e-3)],
        CYLINDER: [(1e-3, 1e-3, 1.0), (1.0, 1.0, 1e-3)],
        SPHERE: [(1e-4, 1e-4, 1e-4), (2.0, 2.0, 2.0)],
    }
    for first, second in product(KINDS, KINDS):
        for one, other in product(sizes[first], sizes[second]):
            for gap in (0.0, 9e-4, 1.1e-3, 0.01):
                a = Solid(first, one, Rotation.random(rng=rng).as_matrix(), np.zeros(3))
                b = Solid(second, other, Rotation.random(rng=rng).as_matrix(), np.zeros(3))
                assert near(a, apart(rng, a, b, gap)) == (gap < MARGIN)
