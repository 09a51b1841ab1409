import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from kinfeas.core.spatial import planar_pose
from kinfeas.robots.urdf import Shape
from kinfeas.viz.pictures.projection import Painted, look
from kinfeas.viz.pictures.raster import paint_solids
from kinfeas.viz.pictures.solids import polygons

SIDE = look(0.0, 0.0)  # along +y, x to the right


def block(colour, size, x=0.0, y=0.0):
    shape = Shape("box", size, planar_pose(np.array(x), np.array(y), np.array(0.0)))
    return [Painted(corners, colour) for corners in polygons(shape)]


def image(faces):
    axes = Figure().subplots()
    paint_solids(axes, SIDE, faces, 0.02)
    return axes.images[0] if axes.images else None


def hue(image, x, z):
    """Return which of red, green and blue is brightest at a place, None where nothing is."""
    left, right, low, high = image.get_extent()
    pixels = image.get_array()
    row = int((z - low) / (high - low) * pixels.shape[0])
    column = int((x - left) / (right - left) * pixels.shape[1])
    pixel = pixels[row, column]
    return int(np.argmax(pixel[:3])) if pixel[3] > 0.5 else None


def test_the_nearer_one_hides_the_other_however_they_interlock():
    # A bar through a ring: before its back board, behind its front board.
    ring = block("red", (1.0, 0.1, 0.2), y=-0.5) + block("red", (1.0, 0.1, 1.0), y=0.5)
    bar = block("lime", (0.2, 0.6, 0.8))
    for faces in (ring + bar, bar + ring):
        seen = image(faces)
        assert hue(seen, 0.0, 0.0) == 0  # the front board
        assert hue(seen, 0.0, 0.3) == 1  # the bar above it
        assert hue(seen, 0.3, 0.3) == 0  # the back board


def test_a_box_covers_its_outline_and_no_more():
    seen = image(block("blue", (1.0, 1.0, 0.6), x=2.0))
    assert hue(seen, 2.0, 0.0) == 2
    assert hue(seen, 1.53, 0.27) == 2
    assert hue(seen, 1.47, 0.0) is None
    assert seen.get_array()[..., 3].sum() * 0.02**2 == pytest.approx(0.6, rel=0.03)


def test_light_keeps_the_hue_and_never_brightens():
    pixels = image(block("#8040c0", (1.0, 1.0, 1.0))).get_array()
    middle = pixels[pixels.shape[0] // 2, pixels.shape[1] // 2, :3]
    share = middle / to_rgb("#8040c0")
    assert share.max() == pytest.approx(share.min())
    assert 0.3 < share.max() <= 1.0


def test_nothing_to_see_draws_nothing():
    away = [face for face in block("red", (1.0, 1.0, 1.0)) if face.corners[:, 1].min() > 0.4]
    assert image(away) is None
