"""Films as GIF or MP4 files, or as a PNG with some of their pictures."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib import get_data_path
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from kinfeas.core.errors import KinfeasError
from kinfeas.evaluation.recording import Recording
from kinfeas.io.files import replacing
from kinfeas.io.run_log import TASK_DONE
from kinfeas.viz.style import EE, FAILURE, INK, failures_text

SUFFIXES = (".gif", ".mp4", ".png")
SIZE = (480, 360)
"""Width and height of a picture in pixels."""

_RATES = {".gif": (8.0, 56), ".mp4": (25.0, 300)}  # pictures per second, largest number
_REST_SECONDS = 1.5  # of the last picture
_COLOURS = 128  # of a GIF
_PANELS = (2, 2)  # of a PNG


@dataclass(frozen=True, eq=False)
class Film:
    """A recorded episode with pictures and a title for their captions."""

    recording: Recording
    title: str

    def picture(self, moment: int) -> Image.Image:
        """Return the picture of one moment with the paths until then."""
        raise NotImplementedError


def write_film(film: Film, path: Path, on_done: Callable[[int], None] | None = None) -> None:
    """Write a film as GIF or MP4, or four of its pictures as PNG.

    `on_done` is called with 1 after each picture, `count_pictures` times.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise KinfeasError(f"{path}: a film must end in one of: {', '.join(SUFFIXES)}")
    moments = _moments(film, path)
    rate, _ = _RATES.get(suffix, (0.0, 0))
    speed = max(1.0, film.recording.times[-1] * rate / len(moments))

    shown = []
    for moment in moments:
        shown.append(captioned(film, int(moment), speed))
        if on_done is not None:
            on_done(1)
    with replacing(path) as fresh:
        if suffix == ".png":
            _write_png(shown, fresh)
        elif suffix == ".gif":
            _write_gif(shown, fresh, rate)
        else:
            _write_mp4(shown, fresh, rate)


def count_pictures(film: Film, path: Path) -> int:
    """Return the number of pictures that `write_film` draws."""
    return len(_moments(film, path))


def result(recording: Recording) -> tuple[str, bool]:
    """Return the result of an episode as a text, and whether it is a success."""
    text = "goal reached" if recording.reached else "goal not reached"
    succeeded = recording.reached and recording.task_done is not False
    return text + TASK_DONE[recording.task_done], succeeded


def captioned(film: Film, moment: int, speed: float = 1.0) -> Image.Image:
    """Return a picture with time, playback speed, IK failures and, at the end, the result."""
    image, recording = film.picture(moment), film.recording
    failures = int(np.sum(~recording.feasible[: moment + 1]))
    faster = f"  ({speed:.1f}x)" if speed > 1.05 else ""
    text = f"{film.title}   {recording.times[moment]:.1f} s{faster}   "
    lines = [[(text, INK), (failures_text(failures), FAILURE if failures else EE)]]
    if moment == len(recording.feasible) - 1:
        end, succeeded = result(recording)
        lines.append([(end, EE if succeeded else FAILURE)])
    font = ImageFont.truetype(f"{get_data_path()}/fonts/ttf/DejaVuSans.ttf", 13)
    draw = ImageDraw.Draw(image, "RGBA")
    for number, words in enumerate(lines):
        left, low = 10.0, image.height - 26 - 27 * number
        width = sum(draw.textlength(text, font=font) for text, _ in words)
        frame = (left - 5, low - 4, left + width + 6, low + 19)
        draw.rounded_rectangle(frame, 5, fill=(255, 255, 255, 205))
        for text, colour in words:
            draw.text((left, low), text, fill=colour, font=font)
            left += draw.textlength(text, font=font)
    return image


def _moments(film: Film, path: Path) -> NDArray[np.intp]:
    times = film.recording.times
    rate, most = _RATES.get(path.suffix.lower(), (0.0, 0))
    count = min(most, int(np.ceil(times[-1] * rate))) if rate else _PANELS[0] * _PANELS[1]
    return np.unique(np.linspace(0, len(times) - 1, max(2, count)).round().astype(np.intp))


def _write_png(pictures: Sequence[Image.Image], path: Path) -> None:
    columns, gap = _PANELS[0], 6
    width, height = pictures[0].size
    rows = -(-len(pictures) // columns)
    whole = Image.new("RGB", (columns * (width + gap) - gap, rows * (height + gap) - gap), "white")
    for number, picture in enumerate(pictures):
        row, column = divmod(number, columns)
        whole.paste(picture, (column * (width + gap), row * (height + gap)))
    whole.save(path, optimize=True)


def _write_gif(pictures: Sequence[Image.Image], path: Path, rate: float) -> None:
    # The last picture has all colours; one palette keeps the background from flickering.
    palette = pictures[-1].quantize(_COLOURS, method=Image.Quantize.MAXCOVERAGE)
    flat = [one.quantize(palette=palette, dither=Image.Dither.NONE) for one in pictures]
    duration = [round(1000.0 / rate)] * len(flat)
    duration[-1] = round(1000.0 * _REST_SECONDS)
    flat[0].save(path, save_all=True, append_images=flat[1:], duration=duration, loop=0)


def _write_mp4(pictures: Sequence[Image.Image], path: Path, rate: float) -> None:
    import av

    shown = [*pictures, *[pictures[-1]] * round(_REST_SECONDS * rate)]
    with av.open(str(path), "w") as file:
        stream = file.add_stream("libx264", rate=round(rate), options={"crf": "23"})
        stream.width, stream.height = shown[0].size
        stream.pix_fmt = "yuv420p"
        for picture in shown:
            file.mux(stream.encode(av.VideoFrame.from_image(picture)))
        file.mux(stream.encode(None))
