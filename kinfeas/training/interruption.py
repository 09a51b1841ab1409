"""Ctrl-C between two steps, never within one."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Put off Ctrl-C until the block is complete, so that nothing is left half done.

    Raises:
        KeyboardInterrupt: At the end of the block, if Ctrl-C came meanwhile.
    """
    if threading.current_thread() is not threading.main_thread():
        yield  # where Python delivers no signals
        return
    came = False

    def note(*_: object) -> None:
        nonlocal came
        came = True

    before = signal.signal(signal.SIGINT, note)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    if came:
        raise KeyboardInterrupt
