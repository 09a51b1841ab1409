import numpy as np
import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import IDENTITY, make_pose, rotation
from kinfeas.robots.urdf import Shape
from kinfeas.scenes.check import _lowest
from kinfeas.scenes.scene import read_scene

SHELF = "[-1.0, 0.0, 0.4]"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (SHELF, "[0.8, 0.1, 0.4]", "objects 'table' and 'shelf' stand within each other"),
        # The table's top ends at 0.52 m, and standing on it may be off by a millimetre.
        (SHELF, "[1.0, 0.0, 0.5185]", "stand within each other, by more than the 1 mm"),
        (SHELF, "[-2.5, 0.0, 0.4]", r"'shelf' stands at \(-2.5, 0\), off the floor of 4 x 3 m"),
        ("[1.0, 0.0, 0.0]", "[1.0, 0.0, -0.1]", "object 'table' reaches 0.1 m below the floor"),
    ],
)
def test_objects_that_cannot_stand_so_are_refused(write, old, new, message):
    with pytest.raises(KinfeasError, match=message) as caught:
        read_scene(write(old, new))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("height", [0.5195, 0.52, 0.53])
def test_an_object_may_stand_on_another_one(write, height):
    turned = f"[1.0, 0.0, {height}], rpy: [0.0, 0.0, 3.141592653589793]"
    read_scene(write(SHELF, turned))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (SHELF, "[-1.0, 0.0, 1.7]", r"its height must be in \[0.1, 1.6\] m, not 1.87"),
        (
            "table.urdf, position: [1.0, 0.0,",
            "box.urdf, position: [-0.7, -0.1, 0.6], rpy: [0.0, 0.0,",
            "before it",
        ),
        (
            "link: handle",
            "link: handle, rpy: [0.0, 0.0, 3.141592653589793]",
            "within 0.13 m before",
        ),
        # In a corner of the floor, its door to the wall.
        (
            SHELF,
            "[1.8, 1.2, 0.4]",
            "handle 'door' cannot be reached: no base finds room within 1.1",
        ),
    ],
)
def test_handles_that_cannot_be_reached_are_refused(write, old, new, message):
    with pytest.raises(KinfeasError, match=message) as caught:
        read_scene(write(old, new))
    assert "'door' cannot be reached" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_handle_may_look_over_a_table(write):
    # Above it, and reached from beside it.
    read_scene(write("[1.0, 0.0, 0.0]", "[-0.3, 0.0, 0.0]"))


@pytest.mark.parametrize("kind", ["box", "cylinder", "sphere"])
def test_the_lowest_point_is_that_of_the_surface(kind):
    rng = np.random.default_rng(0)
    size = {"box": (0.2, 0.3, 0.5), "cylinder": (0.2, 0.7), "sphere": (0.3,)}[kind]
    unit = rng.normal(size=(200_000, 3))
    surface = {
        "box": rng.uniform(-0.5, 0.5, (200_000, 3)) * [0.2, 0.3, 0.5],
        "cylinder": np.column_stack(
            [
                0.2 * unit[:, :2] / np.linalg.norm(unit[:, :2], axis=1, keepdims=True),
                0.35 * np.sign(unit[:, 2]),
            ]
        ),
        "sphere": 0.3 * unit / np.linalg.norm(unit, axis=1, keepdims=True),
    }[kind]
    for turn in np.linspace(0.0, 2.0, 5):
        orientation = rotation(IDENTITY).from_rotvec([turn, 0.4 * turn, 0.1])
        pose = make_pose(np.array([1.0, 2.0, 0.8]), orientation)
        lowest = (orientation.apply(surface) + pose[:3])[:, 2].min()
        assert _lowest(Shape(kind, size, pose)) == pytest.approx(lowest, abs=0.02)
        assert _lowest(Shape(kind, size, pose)) <= lowest + 1e-9
