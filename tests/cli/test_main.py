import numba
import pytest

from kinfeas.cli import main as module
from kinfeas.cli.output import progress, status
from kinfeas.core.errors import KinfeasError
from tests.cli.conftest import HEAVY, kinfeas_process


def test_help_imports_nothing_heavy():
    heavy = {"numpy", "numba", "torch", "matplotlib", "rich"}
    assert kinfeas_process(HEAVY % heavy, "--help").stderr.endswith("heavy: []")


def raising(error):
    def app(**_):
        raise error

    return app


@pytest.mark.parametrize(("error", "code", "message"), [
    (KinfeasError("first\n  second"), 2, "error: first second\n"),
    (PermissionError(13, "Permission denied", "/locked"), 2, "error: [Errno 13] Permission denied"),
    (OSError("gone"), 2, "error: gone\n"),
    (KeyboardInterrupt(), 130, ""),
])  # fmt: skip
def test_errors_are_one_line_and_a_code(monkeypatch, capsys, error, code, message):
    monkeypatch.setattr(module, "app", raising(error))
    with pytest.raises(SystemExit) as end:
        module.main()
    assert end.value.code == code
    assert capsys.readouterr().err.startswith(message)


def test_programming_errors_keep_their_traceback(monkeypatch):
    monkeypatch.setattr(module, "app", raising(ZeroDivisionError))
    with pytest.raises(ZeroDivisionError):
        module.main()


@pytest.mark.parametrize("error", [KeyError("x"), SystemExit(0)])
def test_errors_of_plugins_have_a_traceback_and_the_code_of_bad_input(monkeypatch, capsys, error):
    error.add_note("raised by adapter Mine")
    monkeypatch.setattr(module, "app", raising(error))
    with pytest.raises(SystemExit) as end:
        module.main()
    printed = capsys.readouterr().err
    assert end.value.code == 2
    assert "Traceback" in printed
    assert "adapter Mine" in printed.splitlines()[-1]


@pytest.mark.parametrize("words", [(), ("--help",), ("--version",)])
def test_help_and_version_succeed(kinfeas, words):
    done = kinfeas(*words)
    assert (done.code, done.err) == (0, "")
    assert "kinfeas" in done.out


@pytest.mark.parametrize("terminal", [True, False])
@pytest.mark.parametrize("shown", [progress, lambda: status("searching")])
def test_a_terminal_shows_once_that_kernels_are_compiled(monkeypatch, capfd, shown, terminal):
    monkeypatch.setenv("TTY_COMPATIBLE", "1" if terminal else "0")
    double = numba.njit(lambda value: value + value)
    with shown():
        assert (double(1), double(1.0)) == (2, 2.0)
    with shown():
        double(1)
    out, err = capfd.readouterr()
    assert (out, err.count("compiling kernels")) == ("", int(terminal))
