"""A second process that stops the base if the run stalls or dies.

The run sends heartbeats through a pipe, which closes when the run dies. The watchdog answers each,
so that the run notices if it stalls or dies. It imports little besides the backend's function that
stops the base.
"""

import json
import os
import select
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict
from importlib import import_module
from typing import TYPE_CHECKING

from kinfeas.core.errors import PLUGIN_ERRORS, KinfeasError

if TYPE_CHECKING:  # takes long to import
    from kinfeas.core.backend import StopCall

INTERVAL, REPEATS = 0.05, 10
"""Seconds between stops, and their number after the run died: messages may be lost."""

LAST_TRY = 5.0
"""Seconds after the run died during which failing stops are repeated."""

_BEAT, _END, _READY, _FIRED = b".", b"q", b"r", b"f"
_CHUNK = 4096  # bytes, more than arrive at a time
_CONNECT_TIMEOUT, _EXIT_TIMEOUT = 60.0, LAST_TRY + 2.0  # s


class Watchdog:
    """The run's side of the watchdog; a context."""

    def __init__(self, stop: "StopCall", seconds: float) -> None:
        """Start the process and wait until it can stop the base; raise KinfeasError if it cannot.

        After `seconds` without a heartbeat it stops the base; after as many without an answer it
        counts as lost.
        """
        order = json.dumps({"stop": asdict(stop), "seconds": seconds})
        # In a session of its own, since Ctrl-C is sent to all processes of a terminal's group.
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "kinfeas.sim2real.deploy.watchdog", order],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0, start_new_session=True,
        )  # fmt: skip
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._in, self._out = self._process.stdin, self._process.stdout
        self._seconds, self._unanswered = seconds, deque[float]()
        self._fired = self._stalled = False
        os.set_blocking(self._in.fileno(), False)
        ready = select.select([self._out], [], [], _CONNECT_TIMEOUT)[0]
        if not ready or self._out.read(1) != _READY:
            self._process.kill()
            self.close()
            raise KinfeasError(f"the watchdog could not connect to the robot by {stop.path!r}")

    def __enter__(self) -> "Watchdog":
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """End the process; after an exception other than KinfeasError it stops the base first."""
        if kind is not None and not issubclass(kind, KinfeasError):
            self.abandon()
        self.close()

    def beat(self) -> str:
        """Send a heartbeat; return why the watchdog no longer guards the base, empty if it does."""
        try:
            self._in.write(_BEAT)
        except (OSError, ValueError):  # ValueError: closed by `abandon`
            return "the watchdog has died"
        now = time.monotonic()
        self._unanswered.append(now)
        if select.select([self._out], [], [], 0.0)[0]:
            if not (answers := self._out.read(_CHUNK)):
                return "the watchdog has died"
            self._fired |= _FIRED in answers
            for _ in answers[: len(self._unanswered)]:
                self._unanswered.popleft()
        self._stalled = bool(self._unanswered) and now - self._unanswered[0] > self._seconds
        late = f"for {self._seconds:g} s (guards.watchdog): is the computer busy?"
        if self._fired:
            return f"the watchdog has stopped the base: no heartbeat came {late}"
        return f"the watchdog has not answered {late}" if self._stalled else ""

    def abandon(self) -> None:
        """Close the pipe as if the run had died: the process stops the base and ends."""
        self._in.close()

    def close(self) -> None:
        """End the process without a stop of the base; it may be called twice."""
        if self._process.returncode is not None:
            return
        if not self._in.closed:
            with suppress(OSError):
                self._in.write(_END)
            if self._stalled:  # it would not end by itself
                self._process.kill()
        try:
            self._process.wait(_EXIT_TIMEOUT)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._in.close()
        self._out.close()


def main(order: str) -> None:
    """Watch the heartbeats on standard input; `order` is the JSON that `Watchdog` passes."""
    settings, answers = json.loads(order), os.dup(1)
    os.dup2(2, 1)  # prints of libraries must not be read as answers
    try:
        module, _, name = settings["stop"]["path"].partition(":")
        stop = _Stop(getattr(import_module(module), name)(**settings["stop"]["arguments"]))
    except PLUGIN_ERRORS as error:
        sys.exit(f"watchdog: {error!r}")
    os.write(answers, _READY)
    if _watch(stop, settings["seconds"], answers):
        end, stops = time.monotonic() + LAST_TRY, 0
        while stops < REPEATS and time.monotonic() < end:
            stops += stop("the run died")
            time.sleep(INTERVAL)


class _Stop:
    """Commands the base to zero, prints the result if it is new, and returns whether it worked."""

    def __init__(self, stop: Callable[[], None]) -> None:
        self._stop, self._printed = stop, ""

    def __call__(self, why: str) -> bool:
        failed = ""
        try:
            self._stop()
        except PLUGIN_ERRORS as error:
            failed = f"the base could not be commanded to zero: {error!r}"
        line = f"watchdog: {why}: {failed or 'base commanded to zero'}\n"
        if line != self._printed:
            _print(line)
            self._printed = line
        return not failed


def _watch(stop: _Stop, seconds: float, answers: int) -> bool:
    """Stop the base if heartbeats stop coming after the first one; return whether the run died.

    The pipe closes when the run dies. Once begun, stops are repeated although heartbeats return: a
    stalled run that continues must not move the base.
    """
    timeout: float | None = None
    fired, stalled = False, f"no heartbeat of the run for {seconds:g} s"
    while True:
        if not select.select([0], [], [], timeout)[0]:
            stop(stalled)
            if not fired:
                with suppress(OSError):
                    os.write(answers, _FIRED)
            fired, timeout = True, INTERVAL
            continue
        received = os.read(0, _CHUNK)
        if not received or _END in received:
            return not received
        if fired:
            stop(stalled)
        else:
            timeout = seconds
            with suppress(OSError):
                os.write(answers, received)


def _print(line: str) -> None:
    try:
        os.write(2, line.encode(errors="backslashreplace"))
    except OSError:  # the reader has died; a stop that prints must not fail for it
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, 1)
        os.dup2(null, 2)
        os.close(null)


if __name__ == "__main__":
    main(sys.argv[1])
