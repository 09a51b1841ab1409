"""ROS 1: a node in this process, its topics, and a connection that shows whether the master lives.

This module imports nothing heavy, since the process of the watchdog uses it.
"""

import os
import socket
import sys
import threading
import time
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from urllib.parse import urlsplit

from kinfeas.core.errors import Fault, KinfeasError
from kinfeas.sim2real.ros.bus import Publisher

_DEBIAN = "/usr/lib/python3/dist-packages", "/opt/ros/noetic/lib/python3/dist-packages"
_CONNECT_TIMEOUT = 2.0  # s, for the master
_FLUSH = 0.05  # s for rospy's writing threads before their connections are closed
_SHUT_DOWN = "this node was shut down, as rosnode kill does it"
_LOCAL = {"localhost", "127.0.0.1", "::1"}

_lock = threading.Lock()


class Ros1Bus:
    """Topics of ROS 1."""

    def __init__(self) -> None:
        self.messages: Any = None
        self._master: MasterWatch | None = None
        self._topics: list[Any] = []

    def open(self, name: str) -> None:
        """Make this process a node; raise KinfeasError without ROS 1 or its master."""
        start_node(name)
        self._master, self.messages = MasterWatch(), ros1_message_classes()

    def publisher(self, topic: str, kind: Any) -> Publisher:
        """Return a sender of the newest message, which a thread of rospy writes."""
        publisher = ros("rospy").Publisher(topic, kind, queue_size=1, tcp_nodelay=True)
        self._topics.append(publisher)
        return _Ros1Publisher(publisher)

    def subscribe(
        self, topic: str, kind: Any, take: Callable[[Any], None], *, every: bool = False
    ) -> None:
        """Pass messages to `take`, from a thread: `every` one, or the newest."""
        queue = None if every else 1
        subscriber = ros("rospy").Subscriber(topic, kind, take, queue_size=queue, tcp_nodelay=True)
        self._topics.append(subscriber)

    def senders(self, topic: str, kind: Any) -> int:
        """Return the number of other nodes that publish a topic."""
        rospy = ros("rospy")
        publishers, *_ = ros("rosgraph").Master(rospy.get_name()).getSystemState()
        nodes = dict(publishers).get(rospy.resolve_name(topic), [])
        return len(set(nodes) - {rospy.get_name()})

    def check(self) -> None:
        """Raise Fault if the node was shut down or the master has died."""
        if _shut_down():
            raise Fault(_SHUT_DOWN)
        if self._master is not None:
            self._master.check()

    def close(self) -> None:
        """Deliver what was sent and release the topics; the node stays."""
        if self._master is None:
            return
        time.sleep(_FLUSH)
        if self._master.alive():  # or unregistering would block
            for topic in self._topics:
                topic.unregister()
        self._master.close()
        self._master, self._topics = None, []


class _Ros1Publisher:
    def __init__(self, publisher: Any) -> None:
        self._publisher = publisher

    def publish(self, message: Any) -> None:
        if _shut_down():  # rospy then drops messages without an error
            raise Fault(_SHUT_DOWN)
        try:
            self._publisher.publish(message)
        except ros("rospy").ROSException as error:
            # rospy closes topics a moment before it calls itself shut down.
            raise Fault(_SHUT_DOWN if _shut_down() else str(error)) from error

    def listeners(self) -> int:
        return self._publisher.get_num_connections()


def _shut_down() -> bool:
    """Return whether the node was shut down, or will be."""
    return bool(ros("rospy").core.is_shutdown_requested())


def ros1_message_classes() -> Any:
    """Return the message classes of ROS 1; raise KinfeasError if one is not installed."""
    rospy, gripper = ros("rospy"), "pr2_controllers_msgs/Pr2GripperCommand"
    # Debian has no package of PR2's messages.
    made = ros("genpy.dynamic").generate_dynamic(gripper, "float64 position\nfloat64 max_effort\n")
    classes = {"Pr2GripperCommand": made[gripper], "Time": rospy.Time, "Duration": rospy.Duration}
    for line in Path(__file__).with_name("messages.txt").read_text(encoding="utf-8").splitlines():
        package, _, name = line.split()[0].partition("/")
        if name not in classes:
            classes[name] = getattr(ros(f"{package}.msg"), name)
    return SimpleNamespace(**classes)


def ros(module: str) -> Any:
    """Return a module of ROS 1, such as `rospy`; raise KinfeasError if it is not installed.

    It is searched on the path, then among the system's packages, which are appended to the path, so
    that they shadow none of ours.
    """
    try:
        return import_module(module)
    except ImportError:
        sys.path.extend(path for path in _DEBIAN if path not in sys.path and Path(path).is_dir())
    try:
        return import_module(module)
    except ImportError as error:
        package = "python3-" + module.split(".")[0].replace("_", "-")
        raise KinfeasError(
            f"{module} is missing: apt install {package}, or source the setup.bash of ROS 1"
        ) from error


def start_node(name: str) -> None:
    """Make this process a node; raise KinfeasError without ROS 1 or a master."""
    rospy = ros("rospy")
    with _lock:
        if rospy.core.is_initialized():
            return
        MasterWatch().close()  # rospy would wait for the master without end
        config = Path(__file__).with_name("ros1_logging.yaml")
        os.environ.setdefault("ROS_PYTHON_LOG_CONFIG_FILE", str(config))
        rospy.init_node(
            name, argv=[name], anonymous=True, disable_signals=True, disable_rosout=True,
            disable_rostime=True,
        )  # fmt: skip
        threading.Thread(target=_shut_down_at_exit, args=(rospy,), daemon=True).start()


def _shut_down_at_exit(rospy: Any) -> None:
    """Shut the node down after the main thread: its threads would keep the process alive."""
    threading.main_thread().join()
    rospy.signal_shutdown("the program ended")


class MasterWatch:
    """An idle connection to the ROS master, which closes when the master dies."""

    def __init__(self) -> None:
        """Connect to the master of ROS_MASTER_URI; raise KinfeasError if there is none."""
        self.uri = os.environ.get("ROS_MASTER_URI") or "http://localhost:11311"
        parts = urlsplit(self.uri)
        try:
            host, port = parts.hostname, parts.port
        except ValueError:
            host = port = None
        if not host or not port:
            raise KinfeasError(f"ROS_MASTER_URI must be like http://HOST:11311, not {self.uri!r}")
        if host in _LOCAL and not {"ROS_IP", "ROS_HOSTNAME"} & set(os.environ):
            # A host's own name is often not resolved, and nodes would not find each other.
            os.environ["ROS_IP"] = "127.0.0.1"
        try:
            self._socket = socket.create_connection((host, port), _CONNECT_TIMEOUT)
        except OSError as error:
            raise KinfeasError(
                f"no ROS master at {self.uri} ({error}): start roscore or set ROS_MASTER_URI"
            ) from error
        self._socket.setblocking(False)
        # A cable that is pulled closes no connection: probe it every second.
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for option in (socket.TCP_KEEPIDLE, socket.TCP_KEEPINTVL, socket.TCP_KEEPCNT):
            self._socket.setsockopt(socket.IPPROTO_TCP, option, 1)

    def check(self) -> None:
        """Raise Fault if the master has died."""
        if not self.alive():
            raise Fault(f"the ROS master at {self.uri} died")

    def alive(self) -> bool:
        """Return whether the master lives."""
        try:
            return self._socket.recv(1, socket.MSG_PEEK) != b""
        except BlockingIOError:
            return True
        except OSError:
            return False

    def close(self) -> None:
        """Disconnect; it may be called twice."""
        self._socket.close()
