"""A second process that stops the base once the run no longer says that it is alive.

It is told so by heartbeats through a pipe. They cease when the run stalls, and the pipe closes when
it dies, however that happens. Each is answered, so that the run notices a watchdog that stalls or
dies. The process imports next to nothing but what the backend names to stop its robot.
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
from dataclasses import asdict, dataclass, field
from importlib import import_module
from typing import Protocol, runtime_checkable

from kinfeas.core.errors import PLUGIN_ERRORS, KinfeasError
from kinfeas.sim2real.link.fault import reason_of

AGAIN, TIMES = 0.05, 10
"""Seconds between repeated stops, for a message may be lost, and how many follow a death."""

LAST_TRY = 5.0
"""Seconds after a death for which a stop that fails is tried again."""

_BEAT, _END, _READY, _FIRED = b".", b"q", b"r", b"f"
_MANY = 4096  # bytes, more than there are at a time
_PATIENCE, _FAREWELL = 20.0, LAST_TRY + 2.0  # s, for the process to connect, and to end


@dataclass(frozen=True)
class StopCall:
    """How another process stops the base.

    Attributes:
        path: Function `module:function`. It is called once at the start, so that it can connect
            to the robot, and returns a function without arguments that commands the base to zero
            at once. One that raises is called again.
        arguments: Keyword arguments of the first call, as JSON can hold them.

    Raises:
        TypeError: If JSON cannot hold them.
    """

    path: str
    arguments: dict[str, object] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check that another process can be told of it."""
        json.dumps(self.arguments)


@runtime_checkable
class Watched(Protocol):
    """A backend whose robot moves on when this process dies, and can be stopped from another."""

    def stop_call(self) -> StopCall:
        """Return what the watchdog calls."""
        ...


class Watchdog:
    """The process, as the run sees it; to be used as a context."""

    def __init__(self, stop: StopCall, seconds: float) -> None:
        """Start the process and wait until it is ready to stop the base.

        Args:
            stop: What it calls.
            seconds: Without a heartbeat, after which the base is stopped; without an answer to one,
                after which `beat` tells of it.

        Raises:
            KinfeasError: If the process does not become ready.
        """
        order = json.dumps({"stop": asdict(stop), "seconds": seconds})
        # A session of its own, for Ctrl-C goes to all processes of the terminal's group.
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "kinfeas.sim2real.deploy.watchdog", order],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            bufsize=0,
            start_new_session=True,
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._in, self._out = self._process.stdin, self._process.stdout
        self._seconds, self._unanswered = seconds, deque[float]()
        self._fired = self._stalled = False
        os.set_blocking(self._in.fileno(), False)
        if not select.select([self._out], [], [], _PATIENCE)[0] or self._out.read(1) != _READY:
            self._process.kill()
            self.close()
            raise KinfeasError(f"the watchdog could not connect to the robot by {stop.path!r}")

    def __enter__(self) -> "Watchdog":
        """Return the watchdog."""
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """End the process; after an error that nobody has dealt with, it stops the base before."""
        if kind is not None and not issubclass(kind, KinfeasError):
            self.abandon()
        self.close()

    def beat(self) -> bool:
        """Say that the run is alive; return whether the watchdog is, and has not stopped it."""
        if self._in.closed:
            return False
        try:
            self._in.write(_BEAT)
        except OSError:
            return False
        now = time.monotonic()
        self._unanswered.append(now)
        if select.select([self._out], [], [], 0.0)[0]:
            answers = self._out.read(_MANY)
            self._fired |= _FIRED in answers or not answers
            for _ in answers[: len(self._unanswered)]:
                self._unanswered.popleft()
        self._stalled = bool(self._unanswered) and now - self._unanswered[0] > self._seconds
        return not (self._fired or self._stalled)

    def abandon(self) -> None:
        """Die, as far as the process can tell: it stops the base, several times, and ends."""
        self._in.close()

    def close(self) -> None:
        """End the process, which then stops nothing; it may be called twice."""
        if self._process.returncode is not None:
            return
        if not self._in.closed:
            with suppress(OSError):
                self._in.write(_END)
            if self._stalled:  # or else it would be waited for in vain
                self._process.kill()
        try:
            self._process.wait(_FAREWELL)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._in.close()
        self._out.close()


def main(order: str) -> None:
    """Watch over standard input, as an order in JSON says."""
    given, answers = json.loads(order), os.dup(1)
    os.dup2(2, 1)  # what libraries print must not be read as answers
    try:
        stop = _Stopping(_connect(StopCall(**given["stop"])))
    except PLUGIN_ERRORS as error:
        sys.exit(f"watchdog: {reason_of(error)}")
    os.write(answers, _READY)
    if _watch(stop, given["seconds"], answers):
        _outlive(stop)


def _connect(call: StopCall) -> Callable[[], None]:
    module, _, name = call.path.partition(":")
    stop: Callable[[], None] = getattr(import_module(module), name)(**call.arguments)
    return stop


class _Stopping:
    """The stop of the robot, which never raises: others wrote it, and it will be tried again.

    What came of it is said when it changes, and once for each reason.
    """

    def __init__(self, stop: Callable[[], None]) -> None:
        self._stop, self._said = stop, ("", False)

    def __call__(self, why: str) -> bool:
        """Command the base to zero, and say `why`; return whether that worked."""
        failed = ""
        try:
            self._stop()
        except PLUGIN_ERRORS as error:
            failed = f"the base could not be commanded to zero: {reason_of(error)}"
        if self._said != (why, bool(failed)):
            _say(f"{why}: {failed or 'base commanded to zero'}")
            self._said = why, bool(failed)
        return not failed


def _watch(stop: _Stopping, seconds: float, answers: int) -> bool:
    """Stop the base whenever no heartbeat comes; return whether the run died.

    The first one is waited for: nothing is commanded before it.
    """
    fired = False
    patience: float | None = None
    stalled = f"no sign of life from the run for {seconds:g} s"
    while True:
        # Once fired it stays so: a run that comes back has to end, and must not drive on.
        if not select.select([0], [], [], patience)[0]:
            stop(stalled)
            if not fired:
                with suppress(OSError):
                    os.write(answers, _FIRED)
            fired, patience = True, AGAIN
            continue
        if not fired:
            patience = seconds
        heard = os.read(0, _MANY)
        if _END in heard:
            return False
        if not heard:
            return True
        if fired:
            stop(stalled)
            continue
        with suppress(OSError):
            os.write(answers, heard)


def _outlive(stop: _Stopping) -> None:
    """Stop the base of a run that died, until that has worked often enough or fails for good."""
    end, told = time.monotonic() + LAST_TRY, 0
    while told < TIMES and time.monotonic() < end:
        told += stop("the run died")
        time.sleep(AGAIN)


def _say(sentence: str) -> None:
    try:
        os.write(2, f"watchdog: {sentence}\n".encode(errors="backslashreplace"))
    except OSError:
        # Who reads it may have died with the run, and no stop that prints shall fail for that.
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, 1)
        os.dup2(nowhere, 2)
        os.close(nowhere)


if __name__ == "__main__":
    main(sys.argv[1])
