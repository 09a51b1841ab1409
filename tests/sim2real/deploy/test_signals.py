import os
import signal

import pytest

from kinfeas.sim2real.deploy.signals import Signals


def send(*numbers):
    for number in numbers:
        os.kill(os.getpid(), number)


@pytest.mark.parametrize("name", ["SIGINT", "SIGQUIT", "SIGTERM", "SIGHUP"])
def test_the_first_one_counts_and_handlers_come_back(name):
    number = signal.Signals[name]
    before = signal.getsignal(number)
    with Signals() as signals:
        assert signals.caught is None
        send(number)
        assert signals.caught is number
    assert signal.getsignal(number) is before


def test_whoever_asks_twice_is_not_kept_waiting():
    with Signals() as signals:
        send(signal.SIGTERM)
        with pytest.raises(KeyboardInterrupt):
            send(signal.SIGINT)
    assert signals.caught is signal.SIGTERM


def test_a_terminal_that_is_closed_may_say_so_more_than_once():
    with Signals() as signals:
        send(signal.SIGHUP, signal.SIGHUP)
    assert signals.caught is signal.SIGHUP


def test_a_run_that_is_to_outlive_its_terminal_does(monkeypatch):
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with Signals() as signals:
            send(signal.SIGHUP)
        assert signals.caught is None
        assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)
