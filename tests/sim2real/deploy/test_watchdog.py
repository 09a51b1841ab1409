import os
import signal
import subprocess
import sys
import time

import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.sim2real.deploy.watchdog import LAST_TRY, TIMES, StopCall, Watchdog

pytestmark = pytest.mark.slow

ROBOT = """
import time


def connect(path):
    print("what libraries print is no answer")

    def stop():
        with open(path, "a") as file:
            file.write(f"{time.monotonic()}\\n")

    return stop
"""

FLAKY = """
from kinfeas.sim2real.link.fault import Fault


def connect(path, error, fails):
    left = [fails]

    def stop():
        left[0] -= 1
        if left[0] >= 0:
            raise eval(error)
        with open(path, "a") as file:
            file.write("0\\n")

    return stop


def broken(error):
    raise eval(error)
"""

RUN = """
import sys, time
from kinfeas.sim2real.deploy.watchdog import StopCall, Watchdog

watchdog = Watchdog(StopCall("stand_in:connect", {"path": sys.argv[1]}), 0.2)
print("ready", flush=True)
while True:
    watchdog.beat()
    time.sleep(0.02)
"""


@pytest.fixture
def stops(tmp_path, monkeypatch):
    """Return where the stand-in of a robot writes down when it is stopped."""
    (tmp_path / "stand_in.py").write_text(ROBOT)
    (tmp_path / "flaky.py").write_text(FLAKY)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    return tmp_path / "stops"


def stopped_at(stops):
    return [float(line) for line in stops.read_text().split()] if stops.exists() else []


def beats(watchdog, seconds):
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if not watchdog.beat():
            return False
        time.sleep(0.02)
    return True


def test_is_quiet_while_the_run_lives_and_when_it_ends(stops):
    with Watchdog(StopCall("stand_in:connect", {"path": str(stops)}), 0.5) as watchdog:
        assert beats(watchdog, 0.7)
    watchdog.close()
    assert stopped_at(stops) == []


def test_a_stall_stops_the_base_for_good(stops, capfd):
    with Watchdog(StopCall("stand_in:connect", {"path": str(stops)}), 0.2) as watchdog:
        watchdog.beat()
        began = time.monotonic()
        time.sleep(0.5)
        assert not watchdog.beat()
    assert 0.15 < stopped_at(stops)[0] - began < 0.3
    assert len(stopped_at(stops)) > 2
    assert (
        "no sign of life from the run for 0.2 s: base commanded to zero" in capfd.readouterr().err
    )


def test_a_watchdog_that_stalls_is_noticed(stops):
    with Watchdog(StopCall("stand_in:connect", {"path": str(stops)}), 0.5) as watchdog:
        assert beats(watchdog, 0.1)
        os.kill(watchdog._process.pid, signal.SIGSTOP)
        began = time.monotonic()
        assert not beats(watchdog, 5.0)
        assert 0.4 < time.monotonic() - began < 0.7
    assert time.monotonic() - began < 2.0  # nor is it waited for
    assert stopped_at(stops) == []


def test_counts_from_the_first_sign_of_life(stops):
    with Watchdog(StopCall("stand_in:connect", {"path": str(stops)}), 0.2) as watchdog:
        time.sleep(0.5)
        assert beats(watchdog, 0.3)
    assert stopped_at(stops) == []


@pytest.mark.parametrize("talks", [False, True])
def test_goes_on_stopping_where_nobody_reads_what_it_says(stops, talks):
    if talks:
        robot = stops.parent / "stand_in.py"
        line = "    def stop():\n"
        robot.write_text(ROBOT.replace(line, f'{line}        print("stopping", flush=True)\n'))
    run = subprocess.Popen(
        [sys.executable, "-c", RUN, str(stops)], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    assert run.stdout.readline() == b"ready\n"
    run.stderr.close()
    run.kill()
    run.wait()
    run.stdout.close()
    time.sleep(1.0)
    assert len(stopped_at(stops)) > 5


def test_death_stops_the_base(stops):
    run = subprocess.Popen([sys.executable, "-c", RUN, str(stops)], stdout=subprocess.PIPE)
    assert run.stdout.readline() == b"ready\n"
    assert stopped_at(stops) == []
    killed = time.monotonic()
    run.kill()
    run.wait()
    run.stdout.close()
    time.sleep(0.3)
    assert stopped_at(stops)[0] - killed < 0.3


def test_a_run_that_cannot_stop_its_robot_leaves_that_to_the_watchdog(stops):
    with Watchdog(StopCall("stand_in:connect", {"path": str(stops)}), 5.0) as watchdog:
        watchdog.abandon()
        time.sleep(0.2)
        assert not watchdog.beat()
    assert stopped_at(stops)


def test_an_error_that_nobody_has_dealt_with_stops_the_base(stops):
    with (
        pytest.raises(ZeroDivisionError),
        Watchdog(StopCall("stand_in:connect", {"path": str(stops)}), 5.0),
    ):
        raise ZeroDivisionError
    assert stopped_at(stops)


ERRORS = ["Fault('nothing can be sent')", "KeyError()", "SystemExit('nothing can be sent')"]


@pytest.mark.parametrize("error", ERRORS)
def test_a_stop_that_fails_is_tried_again_whatever_it_raises(stops, error, capfd):
    call = StopCall("flaky:connect", {"path": str(stops), "error": error, "fails": 2})
    with Watchdog(call, 0.2) as watchdog:
        watchdog.beat()
        time.sleep(0.6)
        assert not watchdog.beat()
    assert len(stopped_at(stops)) > 2
    first, second = capfd.readouterr().err.splitlines()
    why = "watchdog: no sign of life from the run for 0.2 s: "
    reason = "KeyError" if "Key" in error else "nothing can be sent"
    assert first == f"{why}the base could not be commanded to zero: {reason}"
    assert second == f"{why}base commanded to zero"


def test_a_run_that_died_is_stopped_as_often_as_ever_if_that_fails_at_first(stops):
    fails = TIMES + 2
    call = StopCall("flaky:connect", {"path": str(stops), "error": ERRORS[0], "fails": fails})
    with Watchdog(call, 5.0) as watchdog:
        watchdog.abandon()
    assert len(stopped_at(stops)) == TIMES


def test_gives_up_where_nothing_can_be_sent_any_more(stops):
    call = StopCall("flaky:connect", {"path": str(stops), "error": ERRORS[0], "fails": 10**9})
    with Watchdog(call, 5.0) as watchdog:
        began = time.monotonic()
        watchdog.abandon()
    assert LAST_TRY < time.monotonic() - began < LAST_TRY + 1.5


@pytest.mark.parametrize(
    ("path", "arguments"),
    [
        ("stand_in:conect", {}),
        ("no_such_module:stop", {}),
        ("stand_in:connect", {}),
        ("flaky:broken", {"error": "KeyError()"}),
        ("flaky:broken", {"error": "SystemExit(0)"}),
    ],
)
def test_does_not_begin_without_a_way_to_stop(stops, path, arguments, capfd):
    with pytest.raises(KinfeasError, match=f"could not connect to the robot by '{path}'"):
        Watchdog(StopCall(path, arguments), 0.2)
    (line,) = capfd.readouterr().err.splitlines()
    assert line.startswith("watchdog: ")


def test_a_call_is_what_another_process_can_be_told_of():
    with pytest.raises(TypeError, match="not JSON serializable"):
        StopCall("stand_in:connect", {"path": object()})
