"""An episode in the PyBullet world as a film or a picture, its EE path drawn into it."""

import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from kinfeas.backends.pybullet.camera import paint_floor, show_moment, take_picture
from kinfeas.backends.pybullet.physics import Physics
from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import Array
from kinfeas.evaluation.paper import TITLES
from kinfeas.evaluation.physics.world import PhysicsTrial, PhysicsWorld
from kinfeas.io.files import replacing
from kinfeas.viz.physics.framing import Framing, frame
from kinfeas.viz.physics.overlay import paths, shaded, write_below
from kinfeas.viz.physics.recording import PhysicsRecording
from kinfeas.viz.pictures.style import DESIRED, EE, FAILURE, GOAL

SUFFIXES = (".gif", ".mp4", ".png")
"""What a film can be written as."""

SIZE = (480, 360)
_FINER = 2  # pixels in each direction that are averaged into one
_GIF, _MP4 = (8.0, 56), (25.0, 300)  # pictures per second, and at most in all
_REST_SECONDS = 1.5  # in which the end is shown
_COLOURS = 72  # of a GIF
_PANELS = (2, 2)  # of a PNG
_OFF_THE_WALLS = 0.3  # m
_TILES = ((236, 238, 241), (218, 222, 228))

OnDone = Callable[[int], None]


class Filmed(Protocol):
    """An episode that can be written as a film."""

    @property
    def times(self) -> Array:
        """Seconds of its moments since its start, shape (t,)."""
        ...

    def picture(self, moment: int, speed: float = 1.0) -> Image.Image:
        """Return the picture of one moment, shown `speed` times faster than it happened."""
        ...


@dataclass(frozen=True, eq=False)
class Film:
    """An episode in the PyBullet world and how to look at it.

    Attributes:
        recording: What happened.
        physics: A world with the same bodies.
        framing: Where the camera is.
        title: What stands below, before the time.
        size: Width and height of its pictures in pixels.
    """

    recording: PhysicsRecording
    physics: Physics
    framing: Framing
    title: str
    size: tuple[int, int] = SIZE

    @property
    def times(self) -> Array:
        """Seconds since the start of the episode, shape (t,)."""
        return self.recording.times

    def picture(self, moment: int, speed: float = 1.0) -> Image.Image:
        """Return the picture of one moment.

        Args:
            moment: Its number.
            speed: How many times faster than it happened it is shown.
        """
        width, height = (_FINER * side for side in self.size)
        show_moment(self.physics, self.recording.moments[moment])
        eye, target = self.framing.eye[moment], self.framing.target[moment]
        seen = take_picture(self.physics, eye, target, (width, height))
        image = Image.fromarray(shaded(seen, self.physics, target)).convert("RGBA")
        image.alpha_composite(paths(seen, self.recording, moment))
        small = image.convert("RGB").resize(self.size, Image.Resampling.BOX)
        kept = self.recording
        failures = int(kept.failures[: moment + 1].sum())
        last = moment == len(kept.moments) - 1
        end = (kept.outcome, kept.succeeded) if last else None
        write_below(small, self.title, (self.times[moment], speed), failures, end)
        return small


def check_film_path(path: Path) -> None:
    """Check that a film can be written as `path` says.

    Raises:
        KinfeasError: If its ending is not one of `SUFFIXES`, or what MP4 needs is not installed.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise KinfeasError(f"{path}: a film must end in one of: {', '.join(SUFFIXES)}")
    if path.suffix.lower() == ".mp4":
        _av()


def make_film(world: PhysicsWorld, trial: PhysicsTrial, recording: PhysicsRecording) -> Film:
    """Return the film of an episode that `recording.record` has just kept."""
    simulation = world.stage.backend.sims[0]
    scene = world.stage.scene
    room = None if scene is None else np.array(scene.size) / 2.0 - _OFF_THE_WALLS
    framing = frame(recording, simulation.body, SIZE, room)
    robot = trial.robot.name
    title = f"{TITLES.get(robot, robot)}, {trial.task.name}"
    with tempfile.TemporaryDirectory() as folder:
        _paint(simulation.physics, Path(folder) / "floor.png")
    return Film(recording, simulation.physics, framing, title)


def write_film(film: Filmed, path: Path, on_done: OnDone | None = None) -> None:
    """Write a film as GIF or MP4, or some of its moments side by side as PNG.

    Args:
        film: What is shown.
        path: File whose ending says which.
        on_done: Called with 1 for each picture drawn; `count_pictures` says how many there are.

    Raises:
        KinfeasError: If the ending is another one, or the file cannot be written.
    """
    check_film_path(path)
    moments = _moments(film.times, path)
    with replacing(path) as fresh:
        if path.suffix.lower() == ".png":
            _write_png(list(_pictures(film, moments, 1.0, on_done)), fresh)
            return
        rate, _ = _GIF if path.suffix.lower() == ".gif" else _MP4
        speed = max(1.0, film.times[-1] * rate / len(moments))
        write = _write_gif if path.suffix.lower() == ".gif" else _write_mp4
        write(_pictures(film, moments, speed, on_done), fresh, rate)


def count_pictures(film: Filmed, path: Path) -> int:
    """Return how many pictures `write_film` draws."""
    return len(_moments(film.times, path))


def _moments(times: Array, path: Path) -> NDArray[np.intp]:
    last = len(times) - 1
    if path.suffix.lower() == ".png":
        count = _PANELS[0] * _PANELS[1]
    else:
        rate, most = _GIF if path.suffix.lower() == ".gif" else _MP4
        count = min(most, int(np.ceil(times[-1] * rate)))
    return np.unique(np.linspace(0, last, max(2, count)).round().astype(np.intp))


def _pictures(
    film: Filmed, moments: Sequence[int] | NDArray[np.intp], speed: float, on_done: OnDone | None
) -> Iterator[Image.Image]:
    for moment in moments:
        yield film.picture(int(moment), speed=speed)
        if on_done is not None:
            on_done(1)


def _write_png(pictures: Sequence[Image.Image], path: Path) -> None:
    columns = _PANELS[0]
    width, height = pictures[0].size
    gap, rows = 6, -(-len(pictures) // columns)
    size = (columns * (width + gap) - gap, rows * (height + gap) - gap)
    whole = Image.new("RGB", size, "white")
    for number, picture in enumerate(pictures):
        row, column = divmod(number, columns)
        whole.paste(picture, (column * (width + gap), row * (height + gap)))
    whole.save(path, optimize=True)


def _write_gif(pictures: Iterator[Image.Image], path: Path, rate: float) -> None:
    shown = list(pictures)
    # One palette for all, of some of them, so that what stands still looks the same throughout.
    some = [*shown[:: max(1, len(shown) // 8)], shown[-1]]
    width, height = shown[0].size
    sheet = Image.new("RGB", (width, height * (len(some) + 1)), "white")
    for number, picture in enumerate(some):
        sheet.paste(picture, (0, number * height))
    for number, colour in enumerate((EE, FAILURE, GOAL, DESIRED)):
        # However little there is of them, these must not be lost.
        sheet.paste(colour, (0, len(some) * height + 60 * number, width, (len(some) + 1) * height))
    palette = sheet.quantize(_COLOURS, method=Image.Quantize.MEDIANCUT)
    flat = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in shown]
    duration = [round(1000.0 / rate)] * len(flat)
    duration[-1] = round(1000.0 * _REST_SECONDS)
    flat[0].save(path, save_all=True, append_images=flat[1:], duration=duration, loop=0)


def _write_mp4(pictures: Iterator[Image.Image], path: Path, rate: float) -> None:
    av = _av()
    shown = list(pictures)
    shown += [shown[-1]] * round(_REST_SECONDS * rate)
    with av.open(str(path), "w") as file:
        stream = file.add_stream("libx264", rate=round(rate), options={"crf": "23"})
        stream.width, stream.height = shown[0].size
        stream.pix_fmt = "yuv420p"
        for picture in shown:
            file.mux(stream.encode(av.VideoFrame.from_image(picture)))
        file.mux(stream.encode(None))


def _av() -> Any:
    try:
        import av
    except ImportError as error:
        raise KinfeasError("MP4 needs av: pip install 'kinfeas[video]'; GIF does not") from error
    return av


def _paint(physics: Physics, path: Path) -> None:
    tiles = np.array([[_TILES[0], _TILES[1]], [_TILES[1], _TILES[0]]], dtype=np.uint8)
    Image.fromarray(np.kron(tiles, np.ones((128, 128, 1), dtype=np.uint8))).save(path)
    paint_floor(physics, path)
