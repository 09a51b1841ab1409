import os
import socket
import subprocess
import sys
import time

import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.sim2real.link.fault import Fault
from kinfeas.sim2real.ros import ros1_node
from kinfeas.sim2real.ros.ros1_node import MasterWatch


@pytest.fixture
def server(monkeypatch):
    """Something that listens and says nothing, as a master does."""
    listening = socket.create_server(("127.0.0.1", 0))
    monkeypatch.setenv("ROS_MASTER_URI", f"http://127.0.0.1:{listening.getsockname()[1]}")
    monkeypatch.setenv("ROS_IP", "127.0.0.1")
    yield listening
    listening.close()


def test_knows_at_once_when_the_master_dies(server):
    watch = MasterWatch()
    connection, _ = server.accept()
    watch.check()
    connection.close()
    time.sleep(0.05)
    with pytest.raises(Fault, match=r"the ROS master at http://127\.0\.0\.1:.* died"):
        watch.check()
    watch.close()
    watch.close()


def test_no_master_is_one_clear_sentence_and_no_hang(server):
    server.close()
    begin = time.monotonic()
    with pytest.raises(KinfeasError, match=r"there is no ROS master at .*: start roscore or the"):
        MasterWatch()
    assert time.monotonic() - begin < 1.0


@pytest.mark.parametrize("uri", ["nonsense", "http://", "http://host", "http://host:port"])
def test_an_address_that_is_none(monkeypatch, uri):
    monkeypatch.setenv("ROS_MASTER_URI", uri)
    with pytest.raises(KinfeasError, match="ROS_MASTER_URI must be like http://HOST:11311"):
        MasterWatch()


def test_on_one_machine_nodes_call_themselves_by_an_address_that_works(server, monkeypatch):
    monkeypatch.delenv("ROS_IP")
    monkeypatch.delenv("ROS_HOSTNAME", raising=False)
    MasterWatch().close()
    assert os.environ["ROS_IP"] == "127.0.0.1"


def test_a_missing_ros_says_how_to_get_it(monkeypatch):
    monkeypatch.setattr(ros1_node, "_DEBIAN", ())
    with pytest.raises(
        KinfeasError, match=r"no imaginary_msgs\.msg: .* apt install python3-imaginary-msgs"
    ):
        ros1_node.ros("imaginary_msgs.msg")


def test_the_systems_packages_stand_behind_ours(monkeypatch, tmp_path):
    (tmp_path / "imaginary_msgs.py").write_text("HERE = True\n")
    (tmp_path / "json.py").write_text("raise AssertionError\n")
    monkeypatch.setattr(ros1_node, "_DEBIAN", (str(tmp_path), str(tmp_path / "absent")))
    monkeypatch.setattr(sys, "path", list(sys.path))
    assert ros1_node.ros("imaginary_msgs").HERE
    assert sys.path[-1] == str(tmp_path)


def test_what_the_watchdog_imports_is_small():
    code = "import kinfeas.sim2real.ros.stop, sys; print(sorted(sys.modules))"
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "'numpy'" not in said.stdout
    assert "'rospy'" not in said.stdout
    assert "'cyclonedds'" not in said.stdout
