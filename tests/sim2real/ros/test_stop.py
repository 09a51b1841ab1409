import time
from types import SimpleNamespace

import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.sim2real.link.fault import Fault
from kinfeas.sim2real.ros import stop as ros_stop


class Twist:
    """A message of either kind."""

    def __init__(self):
        self.header = SimpleNamespace(stamp=0.0)


class Bus:
    """A bus of which a test says who listens, and whether anything is carried."""

    def __init__(self):
        self.ears, self.carries, self.sent = 1, True, []
        time_class = SimpleNamespace(from_sec=lambda seconds: seconds)
        self.messages = SimpleNamespace(Twist=Twist, TwistStamped=Twist, Time=time_class)

    def open(self, name):
        pass

    def publisher(self, topic, kind):
        return SimpleNamespace(publish=self.sent.append, listeners=lambda: self.ears)

    def check_sending(self):
        if not self.carries:
            raise Fault("this node was shut down")


@pytest.fixture
def bus(monkeypatch):
    one = Bus()
    monkeypatch.setattr(ros_stop, "make_bus", lambda version: one)
    return one


@pytest.mark.parametrize("stamped", [False, True])
def test_each_stop_is_one_of_now(bus, stamped):
    stop, began = ros_stop.stop_base(1, "/cmd_vel", stamped=stamped), time.time()
    stop()
    stop()
    first, second = (message.header.stamp for message in bus.sent)
    assert (began <= first <= second <= time.time()) if stamped else first == second == 0.0


def test_what_is_silently_lost_is_no_stop(bus):
    stop = ros_stop.stop_base(1, "/cmd_vel")
    bus.carries = False
    with pytest.raises(Fault, match="was shut down"):
        stop()
    assert bus.sent == []


def test_says_that_nobody_listens(bus):
    bus.ears = 0
    with pytest.raises(KinfeasError, match=r"^nobody listens to /cmd_vel within 0\.1 s$"):
        ros_stop.stop_base(1, "/cmd_vel", patience=0.1)
