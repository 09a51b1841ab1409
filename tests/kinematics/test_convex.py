from itertools import product

import coal
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kinfeas.kinematics.convex import BOX, CYLINDER, SCRATCH_ROWS, SPHERE, closer_than
from tests.kinematics.conftest import apart as distance

MARGIN = 1e-3
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
