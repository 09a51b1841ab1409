"""A server of viser that answers its own page only.

By itself, viser accepts websockets from every web site, sets any attribute of a control to any
value, can publish the page through a tunnel, and searches for another port.
"""

import logging
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from html import escape
from http import HTTPStatus
from io import StringIO
from typing import Any
from unittest.mock import patch

import numpy as np
import viser
import websockets.asyncio.server

from kinfeas.core.quantities import FARTHEST
from kinfeas.viz.access import Access

_TITLE = "<title>Viser</title>"
_log = logging.getLogger(__name__)


def _on_one_line(record: logging.LogRecord) -> bool:
    """Replace the traceback of a connection, which then closes, by its exception."""
    if record.exc_info:
        record.msg, record.exc_info = f"{record.msg}: {record.exc_info[1]!r:.200}", None
    return True


_log.addFilter(_on_one_line)


class PageServer(viser.ViserServer):
    """A viser server that answers only its own page, and accepts only values that it offers.

    Attributes:
        url: Address of the page.
        title: Title of the window.
    """

    def __init__(self, title: str, host: str, port: int) -> None:
        """Serve from now on; errors are those of `serving`."""
        self.title, self._access, self._open = title, Access(host, port), False
        self.url, serve = self._access.url, websockets.asyncio.server.serve
        guarded = False

        def serve_guarded(handler: Any, *_: Any, process_request: Any, **options: Any) -> Any:
            nonlocal guarded
            guarded = True

            def respond(connection: Any, request: Any) -> Any:
                return self._respond(process_request, connection, request)

            listener = self._access.listener
            options |= {"sock": listener, "process_request": respond, "logger": _log}
            return serve(handler, **options)

        # The constructor starts the server, and has no arguments for socket and request check.
        with patch.object(websockets.asyncio.server, "serve", serve_guarded):
            super().__init__(host, port, title, verbose=False)
        if not guarded:
            raise RuntimeError("this version of viser serves in another way than 1.1.1")
        receive = self._websock_server._handle_incoming_message

        async def receive_offered(client_id: Any, message: Any) -> None:
            if self._offers(message):
                await receive(client_id, message)

        setattr(self._websock_server, receive.__name__, receive_offered)
        self._open = True

    def rename(self, title: str) -> None:
        """Change the title of the panel, and of windows opened from now on."""
        self.title = title
        self.gui.set_panel_label(title)

    def titled(self, html: str) -> str:
        """Return a page of viser with our title."""
        return html.replace(_TITLE, f"<title>{escape(self.title)}</title>", 1)

    def _respond(self, process_request: Any, connection: Any, request: Any) -> Any:
        """Return the response to a request; None lets a websocket begin."""
        hosts, origins = (request.headers.get_all(name) for name in ("Host", "Origin"))
        if not (self._open and self._access.allows(request.path, hosts, origins)):
            text = "This page opens only at the address that kinfeas printed.\n"
            return connection.respond(HTTPStatus.FORBIDDEN, text)
        request.path = "/"
        request.headers.pop("Accept-Encoding", None)  # a plain body, to replace its title
        response = process_request(connection, request)
        if response is not None:
            response.body = self.titled(response.body.decode()).encode()
            del response.headers["Content-Length"]
            response.headers["Content-Length"] = str(len(response.body))
            response.headers["X-Frame-Options"] = "DENY"
        return response

    def _offers(self, message: Any) -> bool:
        """Return whether a message drags a handle, or gives one of our controls a valid value."""
        kind = type(message).__name__
        if kind == "TransformControlsUpdateMessage":
            position, wxyz = np.array(message.position, float), np.array(message.wxyz, float)
            shaped = position.shape == (3,) and wxyz.shape == (4,)
            unit = np.abs(np.linalg.norm(wxyz) - 1.0) < 1e-3
            return bool(shaped and np.all(np.abs(position) < FARTHEST) and unit)
        if kind != "GuiUpdateMessage":
            return kind in {"TransformControlsDragStartMessage", "TransformControlsDragEndMessage"}
        control: Any = self.gui._gui_input_handle_from_uuid.get(message.uuid)
        if control is None or list(message.updates) != ["value"]:
            return False
        value = message.updates["value"]
        if isinstance(control, viser.GuiDropdownHandle):
            return value in control.options
        return isinstance(value, bool) and isinstance(control.value, bool)


@contextmanager
def serving(title: str, host: str = "127.0.0.1", port: int = 0) -> Iterator[PageServer]:
    """Yield the server of a page, by default at a free port.

    Raises:
        KinfeasError: If the host is not an address of this computer, or the port is in use.
    """
    with redirect_stdout(StringIO()):  # viser prints a banner, `verbose` or not
        server = PageServer(title, host, port)
    try:
        yield server
    finally:
        with redirect_stdout(StringIO()):
            server.stop()
