"""The server of a page; quick to import, so that browsers load the page meanwhile."""

from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from io import StringIO
from typing import Any


@contextmanager
def serving(title: str, host: str = "127.0.0.1", port: int = 0) -> Iterator[Any]:
    """Yield a viser server, by default at a free port."""
    import viser

    with redirect_stdout(StringIO()):  # viser prints a banner, `verbose` or not
        server = viser.ViserServer(host, port, title, verbose=False)
    try:
        yield server
    finally:
        with redirect_stdout(StringIO()):
            server.stop()
