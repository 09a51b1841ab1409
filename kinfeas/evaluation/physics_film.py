"""An episode in the PyBullet world as a film or a picture, its EE path drawn into it."""

import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib import get_data_path
from matplotlib.colors import to_rgb
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from kinfeas.errors import KinfeasError
from kinfeas.evaluation.physics_framing import Framing, visible
from kinfeas.evaluation.physics_recording import PhysicsRecording
from kinfeas.evaluation.pictures import DESIRED, EE, FAILURE, GOAL, INK
from kinfeas.folders import writing
from kinfeas.sim.camera import Picture, paint_floor, show_moment, take_picture
from kinfeas.sim.physics import Physics
from kinfeas.spatial import Array

SUFFIXES = (".gif", ".mp4", ".png")
"""What a film can be written as."""

SIZE = (480, 360)
_FINER = 2  # pixels in each direction that are averaged into one
_GIF, _MP4 = (10.0, 80), (25.0, 300)  # pictures per second, and at most in all
_REST_SECONDS = 1.5  # in which the end is shown
_COLOURS = 96  # of a GIF
_PANELS = (2, 2)  # of a PNG
_HIDDEN = 0.3  # how opaque is what lies behind something
_TILES = ((236, 238, 241), (218, 222, 228))

OnDone = Callable[[int], None]


@dataclass(frozen=True, eq=False)
class Film:
    """An episode and how to look at it.

    Attributes:
        recording: What happened.
        physics: A world with the same bodies.
        framing: Where the camera is.
        title: What stands below, before the time.
    """

    recording: PhysicsRecording
    physics: Physics
    framing: Framing
    title: str

    def picture(self, moment: int, size: tuple[int, int] = SIZE, speed: float = 1.0) -> Image.Image:
        """Return the picture of one moment.

        Args:
            moment: Its number.
            size: Width and height in pixels.
            speed: How many times faster than it happened it is shown.
        """
        width, height = (_FINER * side for side in size)
        show_moment(self.physics, self.recording.moments[moment])
        eye, target = self.framing.eye[moment], self.framing.target[moment]
        seen = take_picture(self.physics, eye, target, (width, height))
        image = Image.fromarray(seen.colour).convert("RGBA")
        image.alpha_composite(_paths(seen, self.recording, moment))
        small = image.convert("RGB").resize(size, Image.Resampling.BOX)
        _write_below(small, self._caption(moment, speed), self._failures(moment))
        return small

    def _caption(self, moment: int, speed: float) -> str:
        faster = f"  ({speed:.1f}x)" if speed > 1.05 else ""
        return f"{self.title}   {self.recording.times[moment]:.1f} s{faster}"

    def _failures(self, moment: int) -> int:
        return int(self.recording.failures[: moment + 1].sum())


def check_film_path(path: Path) -> None:
    """Check that a film can be written as `path` says.

    Raises:
        KinfeasError: If its ending is not one of `SUFFIXES`, or what MP4 needs is not installed.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise KinfeasError(f"{path}: a film must end in one of: {', '.join(SUFFIXES)}")
    if path.suffix.lower() == ".mp4":
        _av()


def write_film(film: Film, path: Path, on_done: OnDone | None = None) -> None:
    """Write a film as GIF or MP4, or some of its moments side by side as PNG.

    Args:
        film: What is shown.
        path: File whose ending says which.
        on_done: Called with 1 for each picture drawn; `count_pictures` says how many there are.

    Raises:
        KinfeasError: If the ending is another one, or the file cannot be written.
    """
    check_film_path(path)
    moments = _moments(film.recording, path)
    with writing(path), tempfile.TemporaryDirectory() as folder:
        _paint(film.physics, Path(folder) / "floor.png")
        if path.suffix.lower() == ".png":
            _write_png(list(_pictures(film, moments, 1.0, on_done)), path)
            return
        rate, _ = _GIF if path.suffix.lower() == ".gif" else _MP4
        speed = max(1.0, film.recording.times[-1] * rate / len(moments))
        write = _write_gif if path.suffix.lower() == ".gif" else _write_mp4
        write(_pictures(film, moments, speed, on_done), path, rate)


def count_pictures(recording: PhysicsRecording, path: Path) -> int:
    """Return how many pictures `write_film` draws."""
    return len(_moments(recording, path))


def _moments(recording: PhysicsRecording, path: Path) -> NDArray[np.intp]:
    last = len(recording.moments) - 1
    if path.suffix.lower() == ".png":
        count = _PANELS[0] * _PANELS[1]
    else:
        rate, most = _GIF if path.suffix.lower() == ".gif" else _MP4
        count = min(most, int(np.ceil(recording.times[-1] * rate)))
    return np.unique(np.linspace(0, last, max(2, count)).round().astype(np.intp))


def _pictures(
    film: Film, moments: Sequence[int] | NDArray[np.intp], speed: float, on_done: OnDone | None
) -> Iterator[Image.Image]:
    for moment in moments:
        yield film.picture(int(moment), speed=speed)
        if on_done is not None:
            on_done(1)


def _paths(picture: Picture, recording: PhysicsRecording, moment: int) -> Image.Image:
    """Return what is drawn over a picture: goals, the desired path, the achieved one, failures."""
    height, width = picture.depth.shape
    layer = Image.new("RGBA", (width, height))
    draw, fine = ImageDraw.Draw(layer), width / (_FINER * SIZE[0])
    ahead, behind = recording.desired[moment:], recording.desired[: moment + 1]
    _line(draw, picture, ahead, DESIRED, 2.2 * fine, dashed=True)
    _line(draw, picture, behind, DESIRED, 2.6 * fine)
    _line(draw, picture, recording.ee[: moment + 1], EE, 4.4 * fine)
    for goal in recording.goals:
        _disc(draw, picture, goal, GOAL, 8.0 * fine)
    failed = behind[recording.failures[: moment + 1] > 0]
    for place in failed:
        _disc(draw, picture, place, FAILURE, 5.0 * fine)
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
    draw: ImageDraw.ImageDraw, picture: Picture, place: Array, colour: str, radius: float
) -> None:
    x, y, depth = picture.project(place[np.newaxis])[0]
    if depth <= 0.0:
        return
    opaque = 1.0 if visible(picture, place[np.newaxis])[0] else _HIDDEN
    draw.ellipse(
        (x - radius, y - radius, x + radius, y + radius),
        fill=_rgba(colour, opaque),
        outline=_rgba("white", opaque),
        width=2,
    )


def _write_below(image: Image.Image, text: str, failures: int) -> None:
    """Write the caption into the lower left corner, and beside it how often IK failed."""
    font = ImageFont.truetype(f"{get_data_path()}/fonts/ttf/DejaVuSans.ttf", 13)
    times = {0: "no failure", 1: "1 failure"}.get(failures, f"{failures} failures")
    draw = ImageDraw.Draw(image, "RGBA")
    left, low = 10, image.height - 26
    first = draw.textlength(f"{text}   ", font=font)
    whole = first + draw.textlength(times, font=font)
    draw.rounded_rectangle(
        (left - 5, low - 4, left + whole + 6, low + 19), 5, fill=(255, 255, 255, 205)
    )
    draw.text((left, low), text, fill=INK, font=font)
    draw.text((left + first, low), times, fill=FAILURE if failures else EE, font=font)


def _write_png(pictures: Sequence[Image.Image], path: Path) -> None:
    columns = _PANELS[0]
    width, height = pictures[0].size
    gap, rows = 6, -(-len(pictures) // columns)
    size = (columns * (width + gap) - gap, rows * (height + gap) - gap)
    whole = Image.new("RGB", size, "white")
    for number, picture in enumerate(pictures):
        row, column = divmod(number, columns)
        whole.paste(picture, (column * (width + gap), row * (height + gap)))
    whole.quantize(255, dither=Image.Dither.NONE).save(path, optimize=True)


def _write_gif(pictures: Iterator[Image.Image], path: Path, rate: float) -> None:
    shown = list(pictures)
    # One palette for all, of some of them, so that what stands still looks the same throughout.
    some = shown[:: max(1, len(shown) // 8)]
    sheet = Image.new("RGB", (some[0].width, some[0].height * len(some)))
    for number, picture in enumerate(some):
        sheet.paste(picture, (0, number * picture.height))
    palette = sheet.quantize(_COLOURS, method=Image.Quantize.MAXCOVERAGE)
    flat = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in shown]
    duration = [round(1000.0 / rate)] * len(flat)
    duration[-1] = round(1000.0 * _REST_SECONDS)
    flat[0].save(path, save_all=True, append_images=flat[1:], duration=duration, loop=0)


def _write_mp4(pictures: Iterator[Image.Image], path: Path, rate: float) -> None:
    av = _av()
    with av.open(str(path), "w") as file:
        stream = file.add_stream("libx264", rate=round(rate), options={"crf": "23"})
        stream.width, stream.height = SIZE
        stream.pix_fmt = "yuv420p"
        last = None
        for last in pictures:
            file.mux(stream.encode(av.VideoFrame.from_image(last)))
        for _ in range(round(_REST_SECONDS * rate) if last is not None else 0):
            file.mux(stream.encode(av.VideoFrame.from_image(last)))
        file.mux(stream.encode(None))


def _av():  # type: ignore[no-untyped-def]
    try:
        import av
    except ImportError as error:
        raise KinfeasError("MP4 needs av: pip install 'kinfeas[video]'; GIF does not") from error
    return av


def _paint(physics: Physics, path: Path) -> None:
    tiles = np.array([[_TILES[0], _TILES[1]], [_TILES[1], _TILES[0]]], dtype=np.uint8)
    Image.fromarray(np.kron(tiles, np.ones((128, 128, 1), dtype=np.uint8))).save(path)
    paint_floor(physics, path)


def _rgba(colour: str, opaque: float) -> tuple[int, int, int, int]:
    red, green, blue = (round(255.0 * part) for part in to_rgb(colour))
    return red, green, blue, round(255.0 * opaque)
