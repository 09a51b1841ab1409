"""A server that answers `reach` and `plan` as JSON over HTTP, and as services of ROS 2."""

import json
import logging
import sys
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from socket import MSG_PEEK, SHUT_WR
from threading import BoundedSemaphore, RLock
from typing import Annotated, Any

from annotated_types import Interval, Len
from pydantic import FailFast

from kinfeas.api import Name
from kinfeas.api.load import load_robot
from kinfeas.api.plan import Plan, plan
from kinfeas.api.reach import facts, reach
from kinfeas.config import from_mapping
from kinfeas.core.errors import KinfeasError
from kinfeas.core.quantities import Metres, Vector
from kinfeas.core.solids import MOST_SOLIDS
from kinfeas.planning.reach import BasePlacer, Placement
from kinfeas.scenes.scene import read_scene
from kinfeas.viz.access import Access

_MOST_BYTES, _MOST_CONNECTIONS, _MOST_BASE_POSES = 4_000_000, 32, 64_000
_BUFFER, _PATIENCE = 65_536, 0.05  # bytes read, and seconds of waiting, beyond `_MOST_CONNECTIONS`
_BUSY = (
    b"HTTP/1.1 503 Service Unavailable\r\nContent-Type: application/json\r\nContent-Length: 33\r\n"
    b'Connection: close\r\n\r\n{"error": "too many connections"}'
)
_log = logging.getLogger(__name__)

SolidRows = Annotated[tuple[tuple[float, ...], ...], Len(0, MOST_SOLIDS), FailFast()]
Pose = Annotated[tuple[Metres, ...], Len(7, 7), FailFast()]


@dataclass(frozen=True)
class ReachRequest:
    """Body of POST /reach; keys are arguments of `reach`, `solids` rows of `Solids.table`."""

    poses: Annotated[tuple[Pose, ...], Len(1, 1000), FailFast()]
    solids: SolidRows = ()
    start: Vector | None = None
    k: Annotated[int, Interval(ge=1, le=512)] = 8
    together: bool = False

    def __post_init__(self) -> None:
        """Limit the time of the answer, since requests are answered one at a time."""
        if len(self.poses) * self.k > _MOST_BASE_POSES:
            raise ValueError(f"'k' must be at most {_MOST_BASE_POSES} / number of poses")


@dataclass(frozen=True)
class PlanRequest:
    """Body of POST /plan; keys are arguments of `plan`, `solids` rows of `Solids.table`."""

    path: Annotated[tuple[Pose, ...], Len(2, 10_000), FailFast()]
    step: Annotated[float, Interval(ge=0.001, le=10.0)] = 0.1
    solids: SolidRows = ()
    start: Vector | None = None
    joints: Annotated[tuple[float, ...], Len(1, 100)] | None = None


class PlanningServer(ThreadingHTTPServer):
    """Server of `reach` and `plan` for one robot in one scene; answers one request at a time.

    HTTP requests are answered for programs on this computer and web pages of the server's address,
    ROS 2 requests for all nodes of the domain. No request can name a robot, a file or code.

    Attributes:
        url: Address.
        lock: Held while a request is answered.
    """

    def __init__(
        self, robot: Name, scene: Name | None = None, port: int = 8081, *, ros2: bool = False
    ) -> None:
        """Listen on the loopback interface, and with `ros2` in the domain of `ROS_DOMAIN_ID`.

        Base and arm avoid the scene's furniture. Port 0 selects a free port. The services of ROS 2
        are those of `kinfeas.sim2real.ros.moveit`.

        Raises:
            KinfeasError: If there is no such robot, scene or domain, or the port is in use.
        """
        self._placer = BasePlacer(load_robot(robot))
        self._scene = None if scene is None else read_scene(str(scene))
        self.lock, self._free = RLock(), BoundedSemaphore(_MOST_CONNECTIONS)
        self.answers = {"/reach": self._base_poses, "/plan": self._motion}
        with ExitStack() as opened:
            if ros2:
                from kinfeas.sim2real.ros.moveit import MoveItServices

                services = MoveItServices(self._placer.solver, self._reach, self._plan)
                opened.callback(services.close)
            self.access = Access("127.0.0.1", port)
            super().__init__(("127.0.0.1", port), _Handler, bind_and_activate=False)
            self.socket.close()
            self.socket, self.url = self.access.listener, self.access.url
            self._opened = opened.pop_all()

    def server_close(self) -> None:
        """Stop listening."""
        super().server_close()
        self._opened.close()

    def process_request(self, request: Any, client_address: Any) -> None:
        """Answer in a new thread, or with status 503 if there are too many connections."""
        if not self._free.acquire(blocking=False):
            with suppress(OSError):
                request.settimeout(_PATIENCE)
                with suppress(TimeoutError):  # closing with unread data would reset the connection
                    request.recv(_BUFFER)
                request.sendall(_BUSY)
                request.shutdown(SHUT_WR)
                request.recv(_BUFFER)
            self.shutdown_request(request)
            return
        try:
            super().process_request(request, client_address)
        except BaseException:  # no thread was started
            self._free.release()
            raise

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Answer a request and make room for another connection."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._free.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Print errors, except those of clients that have disconnected."""
        if not isinstance(sys.exception(), ConnectionError):
            super().handle_error(request, client_address)

    def _reach(self, **arguments: Any) -> list[Placement]:
        with self.lock:
            return reach(self._placer, scene=self._scene, **arguments)

    def _plan(self, **arguments: Any) -> Plan:
        with self.lock:
            return plan(self._placer, scene=self._scene, **arguments)

    def _base_poses(self, body: object) -> object:
        return [facts(placement) for placement in self._reach(**_arguments(ReachRequest, body))]

    def _motion(self, body: object) -> object:
        motion = self._plan(**_arguments(PlanRequest, body))
        messages = {"joint_trajectory": motion.joint_trajectory(), "base_path": motion.base_path()}
        return {"time": motion.time.tolist(), "base": motion.base.tolist(), **messages}


class _Handler(BaseHTTPRequestHandler):
    server: PlanningServer
    timeout = 10.0  # seconds without data after which a request is aborted

    def do_POST(self) -> None:
        hosts, origins = (self.headers.get_all(name, []) for name in ("Host", "Origin"))
        length = self.headers.get("Content-Length", "")
        if not self.server.access.allows("/", hosts, origins):
            self._answer(HTTPStatus.FORBIDDEN, {"error": "use the address that kinfeas printed"})
        elif (answer := self.server.answers.get(self.path)) is None:
            self._answer(HTTPStatus.NOT_FOUND, {"error": "there are POST /reach and POST /plan"})
        elif self.headers.get_content_type() != "application/json" or not length.isdecimal():
            text = "the body must be JSON with its length, and have Content-Type: application/json"
            self._answer(HTTPStatus.UNSUPPORTED_MEDIA_TYPE, {"error": text})
        elif len(length) > len(str(_MOST_BYTES)) or int(length) > _MOST_BYTES:
            text = f"the body must have at most {_MOST_BYTES} bytes"
            self._answer(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, {"error": text})
        else:
            try:
                body = self.rfile.read(int(length))
            except TimeoutError:
                text = f"the body must come without a pause of {self.timeout:g} s"
                self._answer(HTTPStatus.REQUEST_TIMEOUT, {"error": text})
                self.close_connection = True
                return
            try:
                with self.server.lock:
                    if self._has_left():
                        self.close_connection = True
                        return
                    data = answer(_parsed(body))
            except KinfeasError as error:
                self._answer(HTTPStatus.BAD_REQUEST, {"error": str(error)})
            except Exception:
                self._answer(HTTPStatus.INTERNAL_SERVER_ERROR, {"error": "a fault of the server"})
                raise
            else:
                self._answer(HTTPStatus.OK, data)

    def _has_left(self) -> bool:
        """Return whether the client closed the connection while its request was waiting."""
        self.connection.setblocking(False)
        try:
            return not self.connection.recv(1, MSG_PEEK)
        except BlockingIOError:
            return False
        except ConnectionError:
            return True
        finally:
            self.connection.settimeout(self.timeout)

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:
        text = f"{message or HTTPStatus(code).phrase}; there are POST /reach and POST /plan"
        if code == HTTPStatus.NOT_IMPLEMENTED:  # the library's status for GET
            code = HTTPStatus.METHOD_NOT_ALLOWED
        self._answer(HTTPStatus(code), {"error": text})

    def _answer(self, status: HTTPStatus, data: object) -> None:
        body = json.dumps(data).encode()
        self.send_response(status)
        self.send_header("Content-Type", "application/json")
        self.send_header("Content-Length", str(len(body)))
        if status is HTTPStatus.METHOD_NOT_ALLOWED:
            self.send_header("Allow", "POST")
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *values: Any) -> None:
        _log.info(format, *values)


def _parsed(body: bytes) -> object:
    try:
        return json.loads(body)
    except (ValueError, RecursionError) as error:
        raise KinfeasError(f"the body is no JSON: {error}") from error


def _arguments(kind: type[ReachRequest | PlanRequest], body: object) -> dict[str, Any]:
    request = from_mapping(kind, body, "request")
    return {**vars(request), "solids": request.solids or None}
