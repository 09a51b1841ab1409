"""What of a checkpoint is no tensor: its `state.json`, read and checked without torch."""

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, TypeVar

from safetensors import SafetensorError

from kinfeas import config
from kinfeas.config import Interval
from kinfeas.core.errors import KinfeasError

_FORMAT, _STATE = 1, "state.json"

Tally = Annotated[int, Interval(low=0)]

T = TypeVar("T")


def write_state(folder: Path, entries: Mapping[str, Any]) -> None:
    """Write entries, which must fit into JSON, into an existing folder."""
    text = json.dumps({"format": _FORMAT, **entries})
    (folder / _STATE).write_text(text, encoding="utf-8")


def read_state(folder: Path) -> dict[str, Any]:
    """Return the entries that `write_state` wrote, and the format.

    Raises:
        KinfeasError: If there is no checkpoint, or a broken one.
    """
    with loading(folder):
        about: dict[str, Any] = json.loads((folder / _STATE).read_text(encoding="utf-8"))
        if about["format"] != _FORMAT:
            raise ValueError(f"its format is {about['format']}, not {_FORMAT}")
        return about


def checked(cls: type[T], entries: object) -> T:
    """Return entries of a checkpoint's numbers as an instance of the frozen dataclass `cls`.

    Raises:
        ValueError: If one is not what `cls` allows; `loading` makes a sentence of it.
    """
    try:
        return config.from_mapping(cls, entries, _STATE)
    except KinfeasError as error:
        raise ValueError(str(error)) from error


@contextmanager
def loading(folder: Path) -> Iterator[None]:
    """Turn what a missing or broken checkpoint brings about into one `KinfeasError`."""
    try:
        yield
    except KinfeasError:
        raise  # it says all there is to say
    except FileNotFoundError as error:
        raise KinfeasError(f"{folder}: no checkpoint to resume: a file is missing") from error
    except (OSError, SafetensorError, LookupError, ValueError, TypeError, RuntimeError) as error:
        reason = " ".join(str(error).split())[:200]
        raise KinfeasError(
            f"{folder}: broken checkpoint, or one of another run: {type(error).__name__}: {reason}"
        ) from error
