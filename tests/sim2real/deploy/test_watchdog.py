import os
import signal
import subprocess
import sys
import time

import pytest

from kinfeas.core.backend import StopCall
from kinfeas.core.errors import KinfeasError
from kinfeas.sim2real.deploy.watchdog import REPEATS, Watchdog
from tests.builders import wait

pytestmark = pytest.mark.slow

ROBOT = """
import time

def connect(path, error=None, fails=0):
    print("prints of libraries are not answers")
    left = [fails]

    def stop():
        print("stopping", flush=True)
        left[0] -= 1
        if left[0] >= 0:
            raise eval(error)
        with open(path, "a") as file:
            file.write(f"{time.monotonic()}\\n")

    return stop

def broken():
    raise SystemExit(0)
"""

RUN = """
import sys, time
from kinfeas.core.backend import StopCall
from kinfeas.sim2real.deploy.watchdog import Watchdog

watchdog = Watchdog(StopCall("stand_in:connect", {"path": sys.argv[1]}), 0.2)
print("ready", flush=True)
while True:
    watchdog.beat()
    time.sleep(0.02)
"""


@pytest.fixture
def stops(tmp_path, monkeypatch):
    (tmp_path / "stand_in.py").write_text(ROBOT)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    return tmp_path / "stops"


def watchdog(stops, seconds, **arguments):
    return Watchdog(StopCall("stand_in:connect", {"path": str(stops), **arguments}), seconds)


def stopped(stops):
    return [float(line) for line in stops.read_text().split()] if stops.exists() else []


def test_does_nothing_before_the_first_heartbeat_nor_while_there_are_any(stops):
    with watchdog(stops, 5.0) as dog:
        for _ in range(20):
            assert not dog.beat()
            time.sleep(0.01)
    dog.close()
    with watchdog(stops, 0.05):
        time.sleep(0.3)
    assert stopped(stops) == []
    for error in (KinfeasError, ZeroDivisionError):  # an unexpected error stops the base
        with pytest.raises(error), watchdog(stops, 60.0):
            raise error
        assert bool(stopped(stops)) is (error is ZeroDivisionError)


def test_a_stall_stops_the_base_again_and_again(stops, capfd):
    with watchdog(stops, 0.2) as dog:
        dog.beat()
        began = time.monotonic()
        wait(lambda: len(stopped(stops)) > 2)
        assert "stopped the base" in dog.beat()  # a run that comes back must not drive on
        count = len(stopped(stops))
        wait(lambda: not dog.beat() or len(stopped(stops)) > count + 2)
    assert stopped(stops)[0] - began > 0.19
    assert capfd.readouterr().err.count("watchdog: ") == 1


def test_a_watchdog_that_stalls_is_noticed_and_not_waited_for(stops):
    with watchdog(stops, 0.5) as dog:
        assert not dog.beat()
        os.kill(dog._process.pid, signal.SIGSTOP)
        wait(lambda: "not answered" in dog.beat())
    assert dog._process.returncode == -signal.SIGKILL
    assert stopped(stops) == []


@pytest.mark.parametrize("reader", [False, True])
def test_the_death_of_a_run_stops_the_base_whether_or_not_somebody_reads_its_prints(stops, reader):
    command, errors = [sys.executable, "-c", RUN, str(stops)], None if reader else subprocess.PIPE
    run = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=errors)
    assert run.stdout.readline() == b"ready\n"
    if not reader:
        run.stderr.close()
    assert stopped(stops) == []
    run.kill()
    run.wait()
    run.stdout.close()
    wait(lambda: len(stopped(stops)) == REPEATS)


@pytest.mark.parametrize("error", ["KeyError()", "SystemExit('no bus')"])
def test_a_stop_that_fails_is_repeated_while_the_run_stalls_and_after_its_death(
    stops, error, capfd
):
    with watchdog(stops, 0.1, error=error, fails=2) as dog:
        dog.beat()
        wait(lambda: stopped(stops))
        dog.abandon()
        assert "died" in dog.beat()
    assert len(stopped(stops)) > REPEATS
    first, second, *_ = [line for line in capfd.readouterr().err.splitlines() if "dog: " in line]
    assert error.split("(")[0] in first
    assert "could not" not in second


@pytest.mark.parametrize("path", ["no_such_module:stop", "stand_in:connect", "stand_in:broken"])
def test_a_call_that_fails_is_an_error(stops, path, capfd):
    with pytest.raises(KinfeasError, match=path):
        Watchdog(StopCall(path), 0.2)
    assert capfd.readouterr().err.startswith("watchdog: ")
