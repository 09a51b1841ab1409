import os

import pytest

from kinfeas.backends.pybullet.silence import overhear, silence


def test_hears_what_goes_to_either_stream_and_keeps_it_from_the_user(capfd):
    with overhear() as heard:
        os.write(1, b"one\n")
        os.write(2, "zwei ü".encode())
    os.write(1, b"after\n")
    assert heard.getvalue() == "one\nzwei ü"
    assert capfd.readouterr() == ("after\n", "")


def test_hears_what_was_said_before_an_error(capfd):
    with pytest.raises(ZeroDivisionError), overhear() as heard:
        os.write(1, b"oh")
        raise ZeroDivisionError
    assert heard.getvalue() == "oh"


def test_silence_drops_it(capfd):
    with silence():
        os.write(1, b"one")
    assert capfd.readouterr() == ("", "")
