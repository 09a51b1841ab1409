"""Addresses of servers, and a check that a request comes from the own page or from a program."""

import re
import secrets
import socket
from collections.abc import Sequence
from ipaddress import ip_address

from kinfeas.core.errors import KinfeasError

_LOCAL = ("localhost", "127.0.0.1", "[::1]")


class Access:
    """A listening socket with its address, and the check of requests to it.

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
        """Return whether an HTTP or websocket request comes from the own page or a program.

        Other web sites in the same browser reach this address, too. Their requests have their own
        Origin, or as Host a domain name that they point here. They may link to the page, but not
        with a query, which would connect viser's client to another server.

        Args:
            target: Path and query of the request line.
            hosts: Values of the header Host.
            origins: Values of the header Origin.
        """
        host = ",".join(hosts).lower()
        path, _, query = target.partition("?")
        return (
            self._is_here(re.sub(r":\d+$", "", host))
            # Programs, and a browser that opens the page, send no Origin.
            and all(origin.lower() in {f"http://{host}", f"https://{host}"} for origin in origins)
            and secrets.compare_digest(ascii(path.strip("/")), ascii(self._token))
            and query in {"", f"websocket=ws://{host}/{self._token}"}  # added by viser
        )

    def _is_here(self, name: str) -> bool:
        if name in self._names:
            return True
        try:
            ip_address(name.strip("[]"))
        except ValueError:
            return False
        return self._any_address  # unlike a name, an address cannot be pointed elsewhere


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
            probe.connect(("192.0.2.1", 9))  # an address for documentation; UDP sends nothing yet
        except OSError:
            return "localhost"
        return str(probe.getsockname()[0])


def _bracketed(host: str) -> str:
    return f"[{host}]" if ":" in host else host
