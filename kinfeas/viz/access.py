"""Addresses of servers, and the requests that come from their own page or from a program."""

import re
import secrets
import socket
from collections.abc import Sequence
from ipaddress import ip_address

from kinfeas.core.errors import KinfeasError

_LOCAL = ("localhost", "127.0.0.1", "[::1]")


class Access:
    """A bound address, and which requests to it come from its own page.

    Attributes:
        listener: Listening socket.
        url: Address of the page; beyond this computer its path is a random token.
    """

    def __init__(self, host: str, port: int) -> None:
        """Listen at the port; errors are those of `serving`."""
        self.listener = _listen(host, port)
        address, port = self.listener.getsockname()[:2]
        bound = ip_address(address)
        self._token = "" if bound.is_loopback else secrets.token_urlsafe(16)
        self._any_address = bound.is_unspecified
        name = _own_address() if self._any_address else host
        names = {*_LOCAL, _bracketed(host), _bracketed(address), _bracketed(name)}
        if self._any_address:
            names |= {socket.gethostname(), f"{socket.gethostname()}.local"}
        self._names = {name.lower() for name in names}
        self.url = f"http://{_bracketed(name)}:{port}/{self._token}".rstrip("/")

    def allows(self, target: str, hosts: Sequence[str], origins: Sequence[str]) -> bool:
        """Return whether a request, also for a websocket, is one of the page or its reader.

        Arguments are the target of its first line, and its headers Host and Origin.

        A web site in the same browser reaches this address, too. Its websockets have its own
        Origin; under a domain name that it points here, they have that name as Host. It can link
        to the page, but a query would make viser's client run another server's messages.
        """
        host = ",".join(hosts).lower()
        path, _, query = target.partition("?")
        return (
            self._is_here(re.sub(r":\d+$", "", host))
            # There are none in programs, and if one opens the page.
            and all(origin.lower() in {f"http://{host}", f"https://{host}"} for origin in origins)
            and secrets.compare_digest(ascii(path.strip("/")), ascii(self._token))
            and query in {"", f"websocket=ws://{host}/{self._token}"}  # viser adds the second
        )

    def _is_here(self, name: str) -> bool:
        if name in self._names:
            return True
        try:
            ip_address(name.strip("[]"))
        except ValueError:
            return False
        return self._any_address  # an address is no name that points elsewhere next time


def _listen(host: str, port: int) -> socket.socket:
    try:
        family, *_, address = socket.getaddrinfo(
            host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
        dual = family == socket.AF_INET6 and socket.has_dualstack_ipv6()
        return socket.create_server(
            (address[0], port, *address[2:]), family=family, dualstack_ipv6=dual
        )
    except (OSError, UnicodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise KinfeasError(f"host {host!r}, port {port}: {reason}") from error


def _own_address() -> str:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # for documentation; nothing is sent
        except OSError:
            return "localhost"
        return str(probe.getsockname()[0])


def _bracketed(host: str) -> str:
    return f"[{host}]" if ":" in host else host
