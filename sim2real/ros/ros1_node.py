"""A ROS 1 node in this process: found, started and watched without waiting for ever.

This module imports nothing heavy, for the watchdog's process has to be small.
"""

import os
import socket
import sys
import threading
import time
from collections.abc import Iterable
from importlib import import_module
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from kinfeas.core.errors import KinfeasError
from kinfeas.sim2real.link.fault import Fault

_DEBIAN = "/usr/lib/python3/dist-packages", "/opt/ros/noetic/lib/python3/dist-packages"
_PATIENCE = 2.0  # s, for the master to accept a connection
_LOCAL = {"localhost", "127.0.0.1", "::1"}

_lock = threading.Lock()


def ros(module: str) -> Any:
    """Return a module of ROS 1, such as `rospy` or `geometry_msgs.msg`.

    It is looked for where a sourced ROS has it, then among the system's own packages, which stand
    behind all others, so that they put none of theirs into the place of ours.

    Raises:
        KinfeasError: If it is not installed.
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
            f"ROS 1 is not installed here, for there is no {module}: on Debian and Ubuntu it comes "
            f"by apt install {package}, or source the setup.bash of your ROS"
        ) from error


def start_node(name: str) -> None:
    """Make this process a node of its own name that begins with `name`; once is enough.

    Raises:
        KinfeasError: If ROS 1 is not installed, or there is no master.
    """
    rospy = ros("rospy")
    with _lock:
        if rospy.core.is_initialized():
            return
        # rospy would try again for ever.
        MasterWatch().close()
        own = Path(__file__).with_name("ros1_logging.yaml")
        os.environ.setdefault("ROS_PYTHON_LOG_CONFIG_FILE", str(own))
        rospy.init_node(
            name,
            argv=[name],
            anonymous=True,
            disable_signals=True,
            disable_rosout=True,
            disable_rostime=True,
        )
        threading.Thread(target=_end_with, args=(rospy,), daemon=True).start()


def publisher(topic: str, kind: Any) -> Any:
    """Return a publisher that sends the newest message only and without delay.

    Writing is left to a thread, since a robot that hangs must not hang us.
    """
    return ros("rospy").Publisher(topic, kind, queue_size=1, tcp_nodelay=True)


def let_go(watch: "MasterWatch", topics: Iterable[Any]) -> None:
    """Unregister publishers and subscribers, unless there is no master to be told."""
    if watch.alive():
        for one in topics:
            one.unregister()
    watch.close()


def flush() -> None:
    """Give the threads that write a moment, before their connections are closed."""
    time.sleep(0.05)


class MasterWatch:
    """Knows at once when the ROS master dies, by a connection that stays open and says nothing."""

    def __init__(self) -> None:
        """Connect to the master that ROS_MASTER_URI names.

        Raises:
            KinfeasError: If there is none.
        """
        self.uri = os.environ.get("ROS_MASTER_URI") or "http://localhost:11311"
        parts = urlsplit(self.uri)
        try:
            host, port = parts.hostname, parts.port
        except ValueError:
            host = port = None
        if not host or not port:
            raise KinfeasError(f"ROS_MASTER_URI must be like http://HOST:11311, not {self.uri!r}")
        if host in _LOCAL and not {"ROS_IP", "ROS_HOSTNAME"} & set(os.environ):
            # A host's own name often leads nowhere, and nodes would not find each other.
            os.environ["ROS_IP"] = "127.0.0.1"
        try:
            self._socket = socket.create_connection((host, port), _PATIENCE)
        except OSError as error:
            raise KinfeasError(
                f"there is no ROS master at {self.uri} ({error}): start roscore or the robot, or "
                "set ROS_MASTER_URI"
            ) from error
        self._socket.setblocking(False)
        # Where a cable is pulled, nothing closes the connection: ask every second.
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for option in (socket.TCP_KEEPIDLE, socket.TCP_KEEPINTVL, socket.TCP_KEEPCNT):
            self._socket.setsockopt(socket.IPPROTO_TCP, option, 1)

    def check(self) -> None:
        """Do nothing while the master lives.

        Raises:
            Fault: If it died.
        """
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
        """Let go; it may be called twice."""
        self._socket.close()


def _end_with(rospy: Any) -> None:
    """End the node once the main thread has ended, for threads of it would keep the process."""
    threading.main_thread().join()
    rospy.signal_shutdown("the program ended")
