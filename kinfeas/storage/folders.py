"""Folders that are replaced as a whole: whoever is killed while writing one loses nothing."""

import shutil
from collections.abc import Callable
from pathlib import Path

from safetensors import SafetensorError

from kinfeas.errors import KinfeasError
from kinfeas.storage.files import writing


def write_folder(folder: Path, fill: Callable[[Path], None]) -> None:
    """Let `fill(path)` write into a new folder that takes the place of `folder` when complete.

    At any moment there is one complete folder for `find_folder` to find, if there ever was one.

    Raises:
        KinfeasError: If something cannot be written.
    """
    fresh, old = folder.parent / f".{folder.name}.new", _old(folder)
    with writing(folder):
        if old.is_dir() and not folder.is_dir():
            # All that is left by a writer killed between the two renames below.
            old.rename(folder)
        for leftover in (fresh, old):
            shutil.rmtree(leftover, ignore_errors=True)
        fresh.mkdir(parents=True)
        try:
            fill(fresh)
        except SafetensorError as error:
            raise KinfeasError(f"{folder}: cannot be written: {error}") from error
        if folder.is_dir():
            folder.rename(old)
        fresh.rename(folder)
    shutil.rmtree(old, ignore_errors=True)


def find_folder(folder: Path) -> Path:
    """Return `folder`, or what a writer killed while replacing it left in its place."""
    old = _old(folder)
    return old if old.is_dir() and not folder.is_dir() else folder


def _old(folder: Path) -> Path:
    return folder.parent / f".{folder.name}.old"
