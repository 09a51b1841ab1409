"""Quiet for libraries that talk to the user, and what they said."""

import ctypes
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from io import StringIO
from pathlib import Path
from tempfile import TemporaryFile

_STREAMS = (1, 2)


@contextmanager
def silence() -> Iterator[None]:
    """Drop what is written to the standard streams meanwhile, as PyBullet does when it starts."""
    with Path(os.devnull).open("wb") as nowhere, _diverted(nowhere.fileno()):
        yield


@contextmanager
def overhear() -> Iterator[StringIO]:
    """Keep what is written to the standard streams meanwhile; it is there once the block ends."""
    heard = StringIO()
    with TemporaryFile() as file:
        try:
            with _diverted(file.fileno()):
                yield heard
        finally:
            file.seek(0)
            heard.write(file.read().decode(errors="replace"))


@contextmanager
def _diverted(to: int) -> Iterator[None]:
    libc = ctypes.CDLL(None)
    _flush(libc)
    kept = [os.dup(stream) for stream in _STREAMS]
    for stream in _STREAMS:
        os.dup2(to, stream)
    try:
        yield
    finally:
        _flush(libc)
        for stream, before in zip(_STREAMS, kept, strict=True):
            os.dup2(before, stream)
            os.close(before)


def _flush(libc: ctypes.CDLL) -> None:
    sys.stdout.flush()
    sys.stderr.flush()
    libc.fflush(None)
