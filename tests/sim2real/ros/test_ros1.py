import select
import socket

import pytest

from kinfeas.core.errors import Fault, KinfeasError
from kinfeas.sim2real.ros.ros1 import MasterWatch


@pytest.fixture
def server(monkeypatch):
    """A socket that listens, as a master does."""
    listening = socket.create_server(("127.0.0.1", 0))
    monkeypatch.setenv("ROS_MASTER_URI", f"http://127.0.0.1:{listening.getsockname()[1]}")
    monkeypatch.setenv("ROS_IP", "127.0.0.1")
    yield listening
    listening.close()


def test_notices_that_the_master_died(server):
    watch = MasterWatch()
    connection, _ = server.accept()
    watch.check()
    connection.shutdown(socket.SHUT_RDWR)
    select.select([watch._socket], [], [], 60.0)
    with pytest.raises(Fault, match="master"):
        watch.check()
    connection.close()
    watch.close()
    watch.close()


def test_no_master_is_an_error(server):
    server.close()
    with pytest.raises(KinfeasError, match=r"no ROS master at http://127\.0\.0\.1"):
        MasterWatch()
