"""Folders that are replaced as a whole, and folders that one process works in at a time.

Whoever is killed while writing one loses nothing.
"""

import fcntl
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from safetensors import SafetensorError

from kinfeas.core.errors import KinfeasError
from kinfeas.io.files import writing


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


@contextmanager
def alone(folder: Path) -> Iterator[None]:
    """Keep other processes that ask for the same out of a folder, until the end or a kill.

    A file system that has no locks lets all of them in.

    Raises:
        KinfeasError: If another process is in it, or there is no such folder.
    """
    with writing(folder):
        lock = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        _take(lock, folder)
        yield
    finally:
        os.close(lock)


def _take(lock: int, folder: Path) -> None:
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise KinfeasError(f"{folder}: another process is at work in it") from error
    except OSError:
        return  # there are no locks here


def _old(folder: Path) -> Path:
    return folder.parent / f".{folder.name}.old"
