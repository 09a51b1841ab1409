import numba
import pytest

from kinfeas.cli.output import progress, status


@pytest.mark.parametrize("terminal", [True, False])
@pytest.mark.parametrize("shown", [progress, lambda: status("searching")])
def test_commands_say_once_that_kernels_are_compiled(monkeypatch, capfd, shown, terminal):
    monkeypatch.setenv("TTY_COMPATIBLE", "1" if terminal else "0")
    double = numba.njit(lambda value: value + value)
    with shown():
        assert (double(1), double(1.0)) == (2, 2.0)
    with shown():
        double(1)
    out, err = capfd.readouterr()
    assert (out, err.count("compiling kernels")) == ("", 1)
