"""What is drawn into pictures of the PyBullet world: paths, failures, shade and a caption."""

from collections.abc import Sequence
from functools import cache

import numpy as np
from matplotlib import get_data_path
from matplotlib.colors import to_rgb
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont
from scipy.ndimage import gaussian_filter, map_coordinates

from kinfeas.backends.pybullet.camera import Picture, covered_floor
from kinfeas.backends.pybullet.physics import Physics
from kinfeas.core.spatial import Array
from kinfeas.viz.physics.framing import visible
from kinfeas.viz.physics.recording import PhysicsRecording
from kinfeas.viz.pictures.style import DESIRED, EE, FAILURE, GOAL, INK, failures_text

_WIDE = 960  # pixels of a picture in which lines are as wide as their numbers say
_HIDDEN = 0.3  # how opaque is what lies behind something
_SHADED, _CELLS, _BLUR, _DARKEST = 5.0, 320, 0.10, 0.45  # m, cells, m; share of light taken


def shaded(picture: Picture, physics: Physics, target: Array) -> NDArray[np.uint8]:
    """Return the colours of a picture, the floor darker below and beside what stands on it."""
    centre = target[:2]
    covered = covered_floor(physics, centre, _SHADED, _CELLS).astype(float)
    dark = gaussian_filter(covered, _BLUR * _CELLS / (2.0 * _SHADED))
    places = picture.places()[..., :2]
    cell = (places - centre + _SHADED) * _CELLS / (2.0 * _SHADED) - 0.5
    shade = map_coordinates(dark, np.moveaxis(cell, -1, 0), order=1, mode="constant")
    shade[picture.seen != physics.floor] = 0.0
    coloured = picture.colour * (1.0 - _DARKEST * shade[..., np.newaxis])
    return coloured.astype(np.uint8)


def paths(picture: Picture, recording: PhysicsRecording, moment: int) -> Image.Image:
    """Return what is drawn over a picture: goals, the desired path, the achieved one, failures."""
    height, width = picture.depth.shape
    layer = Image.new("RGBA", (width, height))
    draw, fine = ImageDraw.Draw(layer), width / (_WIDE)
    ahead, behind = recording.desired[moment:], recording.desired[: moment + 1]
    _line(draw, picture, ahead, DESIRED, 2.2 * fine, dashed=True)
    _line(draw, picture, behind, DESIRED, 2.6 * fine)
    # What was achieved lies over what was desired, of which it hides what it met.
    _line(draw, picture, recording.ee[: moment + 1], EE, 4.4 * fine)
    for goal in recording.goals:
        _disc(draw, picture, goal, GOAL, 8.0 * fine)
    failed = behind[recording.failures[: moment + 1] > 0]
    for place in failed:
        _disc(draw, picture, place, FAILURE, 5.0 * fine, edge=False)
    return layer


def _line(
    draw: ImageDraw.ImageDraw,
    picture: Picture,
    points: Array,
    colour: str,
    width: float,
    *,
    dashed: bool = False,
) -> None:
    if len(points) < 2:
        return
    flat, seen = picture.project(points), visible(picture, points)
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    for i in range(len(points) - 1):
        if dashed and int(way[i] / 0.04) % 2:
            continue
        if min(flat[i, 2], flat[i + 1, 2]) <= 0.0:
            continue  # behind the camera
        opaque = 1.0 if seen[i] and seen[i + 1] else _HIDDEN
        ends = [tuple(flat[i, :2]), tuple(flat[i + 1, :2])]
        draw.line(ends, fill=_rgba(colour, opaque), width=max(1, round(width)))


def _disc(
    draw: ImageDraw.ImageDraw,
    picture: Picture,
    place: Array,
    colour: str,
    radius: float,
    *,
    edge: bool = True,
) -> None:
    x, y, depth = picture.project(place[np.newaxis])[0]
    if depth <= 0.0:
        return
    opaque = 1.0 if visible(picture, place[np.newaxis])[0] else _HIDDEN
    draw.ellipse(
        (x - radius, y - radius, x + radius, y + radius),
        fill=_rgba(colour, opaque),
        outline=_rgba("white" if edge else colour, opaque),
        width=2,
    )


def write_below(
    image: Image.Image,
    title: str,
    time: tuple[float, float],
    failures: int,
    end: tuple[str, bool] | None = None,
) -> None:
    """Write the caption into the lower left corner.

    Args:
        image: What it is written into.
        title: Its first words.
        time: Seconds since the start, and how many times faster they are shown.
        failures: How often IK has failed until then.
        end: What the episode came to, which stands above, and whether it succeeded; None before.
    """
    faster = f"  ({time[1]:.1f}x)" if time[1] > 1.05 else ""
    text = f"{title}   {time[0]:.1f} s{faster}   "
    _write(image, 0, [(text, INK), (failures_text(failures), FAILURE if failures else EE)])
    if end is not None:
        _write(image, 1, [(end[0], EE if end[1] else FAILURE)])


def _write(image: Image.Image, line: int, words: Sequence[tuple[str, str]]) -> None:
    """Write coloured words into one line, counted from below."""
    font = ImageFont.truetype(f"{get_data_path()}/fonts/ttf/DejaVuSans.ttf", 13)
    draw = ImageDraw.Draw(image, "RGBA")
    left, low = 10.0, image.height - 26 - 27 * line
    whole = sum(draw.textlength(text, font=font) for text, _ in words)
    draw.rounded_rectangle(
        (left - 5, low - 4, left + whole + 6, low + 19), 5, fill=(255, 255, 255, 205)
    )
    for text, colour in words:
        draw.text((left, low), text, fill=colour, font=font)
        left += draw.textlength(text, font=font)


@cache
def _rgba(colour: str, opaque: float) -> tuple[int, int, int, int]:
    red, green, blue = (round(255.0 * part) for part in to_rgb(colour))
    return red, green, blue, round(255.0 * opaque)
