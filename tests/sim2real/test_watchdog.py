import subprocess
import sys
import time

import pytest

from kinfeas.errors import KinfeasError
from kinfeas.sim2real.watchdog import StopCall, Watchdog

ROBOT = """
import time


def connect(path):
    print("what libraries print is no answer")

    def stop():
        with open(path, "a") as file:
            file.write(f"{time.monotonic()}\\n")

    return stop
"""

RUN = """
import sys, time
from kinfeas.sim2real.watchdog import StopCall, Watchdog

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


@pytest.mark.parametrize("path", ["stand_in:conect", "no_such_module:stop"])
def test_does_not_begin_without_a_way_to_stop(stops, path, capfd):
    with pytest.raises(KinfeasError, match=f"could not connect to the robot by '{path}'"):
        Watchdog(StopCall(path), 0.2)
    assert capfd.readouterr().err.startswith("watchdog: ")
