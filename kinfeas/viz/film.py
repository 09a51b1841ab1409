"""Films of episodes as GIF or MP4 files, or as a PNG with some of their pictures."""

import math
from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from kinfeas.backends.pybullet.camera import Camera, View
from kinfeas.core.errors import KinfeasError
from kinfeas.core.files import replacing
from kinfeas.core.spatial import IDENTITY, Array
from kinfeas.robots.urdf import Shape
from kinfeas.viz.replay import EpisodeReplay, Recording, result, shown_moments, side_heading
from kinfeas.viz.shapes import placed
from kinfeas.viz.style import BASE, DESIRED, EE, FAILURE, GOAL, INK, failures_text

_REST_SECONDS = 1.5  # for which the last picture stays
_COLOURS = 128  # of a GIF
_PANELS = (2, 2)  # columns and rows of a PNG
_RATES = {".gif": (8.0, 56), ".mp4": (25.0, 300), ".png": (0.0, _PANELS[0] * _PANELS[1])}
"""Pictures per second, and their largest number, by suffix."""

_ELEVATION, _STEEP = np.deg2rad([30.0, 55.0])  # without solids, and among them
_AROUND, _HEIGHT = 0.7, 1.6  # m, margin of the view around the paths, and its least height
_BEYOND, _HORIZON = 3.0, 40.0  # m, margin of the grid around the view; plain floor beside the grid
_CELL, _LINE, _FLOOR = 0.5, 0.012, 0.01  # m, cells of the grid, width of lines, thickness of boxes
_FINE = 3  # resolution of the layer of paths relative to the picture, against jagged lines


class FilmCamera:
    """A camera beside the path of an episode."""

    def __init__(self, replay: EpisodeReplay) -> None:
        """Set up the camera beside the path; `close` ends its engine."""
        recording = replay.recording
        paths = [recording.base_pose, recording.desired, recording.goals]
        points = np.concatenate([poses[:, :3] for poses in paths])
        low, high = points.min(axis=0) - _AROUND, points.max(axis=0) + _AROUND
        low[2], high[2] = 0.0, max(high[2] - _AROUND, _HEIGHT)
        heading = side_heading(recording) + np.pi / 2.0
        elevation = float(_ELEVATION if recording.solids is None else _STEEP)
        self._view = View.of_box(low, high, heading, elevation)
        floor = _floor(low[:2] - _BEYOND, high[:2] + _BEYOND)
        self._still = [shape.pose for shape, _ in floor]
        moving = [(shape.shape, shape.colour) for shape in replay.shapes]
        self._camera = Camera([*floor, *moving])

    def of(self, replay: EpisodeReplay, moment: int) -> Image.Image:
        """Return the picture of a moment with the paths until then, 480 x 360 pixels."""
        bodies = placed(replay.shapes, replay.links(moment))
        poses = [*self._still, *(body.shape.pose for body in bodies)]
        image = Image.fromarray(self._camera.picture(poses, self._view)).convert("RGBA")
        layer = Image.new("RGBA", (_FINE * image.width, _FINE * image.height))
        _draw_paths(ImageDraw.Draw(layer), self._view, replay.recording, moment + 1)
        layer = layer.resize(image.size, Image.Resampling.BOX)
        return Image.alpha_composite(image, layer).convert("RGB")

    def close(self) -> None:
        """End the camera's engine."""
        self._camera.close()


def film_suffix(path: Path) -> str:
    """Return the suffix of a film in lower case; raise KinfeasError for other formats."""
    suffix = path.suffix.lower()
    if suffix not in _RATES:
        raise KinfeasError(f"{path}: a film must end in one of: {', '.join(_RATES)}")
    return suffix


def write_film(
    replay: EpisodeReplay, path: Path, on_done: Callable[[float], None] | None = None
) -> None:
    """Write an episode as GIF or MP4, or four of its pictures as PNG.

    `on_done` is called after each picture, with its fraction of all pictures.

    Raises:
        KinfeasError: If the suffix is none of these, or PyBullet is not installed.
    """
    suffix = film_suffix(path)
    (rate, most), times = _RATES[suffix], replay.recording.times
    seconds = float(times[-1] - times[0])
    shown = shown_moments(times, min(most, math.ceil(seconds * rate)) if rate else most)
    speed = max(1.0, seconds * rate / len(shown))
    pictures = []
    with closing(FilmCamera(replay)) as film:
        for moment in shown:
            pictures.append(film.of(replay, moment))
            _caption(pictures[-1], replay, moment, speed)
            if on_done is not None:
                on_done(1.0 / len(shown))
    with replacing(path) as fresh:
        if suffix == ".png":
            _write_png(pictures, fresh)
        elif suffix == ".gif":
            _write_gif(pictures, fresh, rate)
        else:
            _write_mp4(pictures, fresh, rate)


def _floor(low: Array, high: Array) -> list[tuple[Shape, str]]:
    def box(centre: Array, size: Array, height: float, colour: str) -> tuple[Shape, str]:
        pose = IDENTITY.copy()
        pose[:3] = *centre, height - _FLOOR / 2.0
        return Shape("box", (*size.tolist(), _FLOOR), pose), colour

    low, high = np.floor(low / _CELL) * _CELL, np.ceil(high / _CELL) * _CELL
    middle, size = (low + high) / 2.0, high - low
    shapes = [box(middle, size + _HORIZON, -0.004, "#f5f6f8")]
    for axis in (0, 1):
        for at in np.arange(low[axis], high[axis] + _CELL / 2.0, _CELL):
            centre, length = middle.copy(), size.copy()
            centre[axis], length[axis] = at, _LINE
            shapes.append(box(centre, length, -0.002, "#dadee4"))
    return shapes


def _draw_paths(draw: ImageDraw.ImageDraw, view: View, recording: Recording, end: int) -> None:
    def at(poses: Array) -> list[tuple[float, float]]:
        return [(x, y) for x, y in (_FINE * view.pixels(poses[:, :3])).tolist()]

    def dot(poses: Array, colour: str, radius: float, edge: str | None = None) -> None:
        for x, y in at(poses):
            box = (x - radius, y - radius, x + radius, y + radius)
            draw.ellipse(box, fill=colour, outline=edge, width=_FINE)

    base, ee = recording.base_pose[:end], recording.ee_pose[:end]
    draw.line(at(base), fill=BASE, width=2 * _FINE)
    for goal in recording.goals:
        draw.line(at(np.stack([goal, goal * [1, 1, 0, 1, 1, 1, 1]])), fill=GOAL, width=_FINE)
    draw.line(at(recording.desired[:end]), fill=DESIRED, width=_FINE)
    draw.line(at(ee), fill="white", width=4 * _FINE)
    draw.line(at(ee), fill=EE, width=2 * _FINE)
    dot(recording.goals, GOAL, 5.0 * _FINE, INK)
    dot(base[:1], "white", 3.0 * _FINE, BASE)
    dot(ee[:1], "white", 3.0 * _FINE, EE)
    dot(ee[~recording.feasible[:end]], FAILURE, 2.5 * _FINE)


def _caption(image: Image.Image, replay: EpisodeReplay, moment: int, speed: float) -> None:
    recording = replay.recording
    failures = int(np.sum(~recording.feasible[: moment + 1]))
    faster = f"  ({speed:.1f}x)" if speed > 1.05 else ""
    seconds = replay.recording.times[moment] - replay.recording.times[0]
    text = f"{replay.title}   {seconds:.1f} s{faster}   "
    lines = [[(text, INK), (failures_text(failures), FAILURE if failures else EE)]]
    if moment == len(recording.feasible) - 1:
        end, succeeded = result(recording)
        lines.append([(end, EE if succeeded else FAILURE)])
    font = ImageFont.load_default(14)
    draw = ImageDraw.Draw(image, "RGBA")
    for number, words in enumerate(lines):
        left, low = 10.0, image.height - 26 - 27 * number
        width = sum(draw.textlength(text, font=font) for text, _ in words)
        frame = (left - 5, low - 4, left + width + 6, low + 19)
        draw.rounded_rectangle(frame, 5, fill=(255, 255, 255, 205))
        for text, colour in words:
            draw.text((left, low), text, fill=colour, font=font)
            left += draw.textlength(text, font=font)


def _write_png(pictures: Sequence[Image.Image], path: Path) -> None:
    columns, gap = _PANELS[0], 6
    width, height = pictures[0].size
    rows = -(-len(pictures) // columns)
    sheet = Image.new("RGB", (columns * (width + gap) - gap, rows * (height + gap) - gap), "white")
    for number, picture in enumerate(pictures):
        row, column = divmod(number, columns)
        sheet.paste(picture, (column * (width + gap), row * (height + gap)))
    sheet.save(path, optimize=True)


def _write_gif(pictures: Sequence[Image.Image], path: Path, rate: float) -> None:
    # The last picture has all colours; one palette keeps the background from flickering.
    palette = pictures[-1].quantize(_COLOURS, method=Image.Quantize.MAXCOVERAGE)
    frames = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
    duration = [round(1000.0 / rate)] * len(frames)
    duration[-1] = round(1000.0 * _REST_SECONDS)
    frames[0].save(path, save_all=True, append_images=frames[1:], duration=duration, loop=0)


def _write_mp4(pictures: Sequence[Image.Image], path: Path, rate: float) -> None:
    import av  # GIF and PNG do not need it

    pictures = [*pictures, *[pictures[-1]] * round(_REST_SECONDS * rate)]
    with av.open(str(path), "w") as file:
        stream = file.add_stream("libx264", rate=round(rate), options={"crf": "23"})
        stream.width, stream.height = pictures[0].size
        stream.pix_fmt = "yuv420p"
        for picture in pictures:
            file.mux(stream.encode(av.VideoFrame.from_image(picture)))
        file.mux(stream.encode(None))
