"""Quiet for libraries that greet the user."""

import ctypes
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

_STREAMS = (1, 2)


@contextmanager
def silence() -> Iterator[None]:
    """Drop what is written to the standard streams meanwhile, as PyBullet does when it starts."""
    libc = ctypes.CDLL(None)
    _flush(libc)
    kept = [os.dup(stream) for stream in _STREAMS]
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for stream in _STREAMS:
        os.dup2(nowhere, stream)
    try:
        yield
    finally:
        _flush(libc)
        for stream, before in zip(_STREAMS, kept, strict=True):
            os.dup2(before, stream)
            os.close(before)
        os.close(nowhere)


def _flush(libc: ctypes.CDLL) -> None:
    sys.stdout.flush()
    sys.stderr.flush()
    libc.fflush(None)
