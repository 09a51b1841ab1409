import subprocess
import sys
from unittest.mock import Mock

import pytest

from kinfeas.cli import main as module
from kinfeas.core.errors import KinfeasError, plugin_note

HEAVY = """
import sys
from kinfeas.cli.main import main
try:
    main()
finally:
    sys.stderr.write(f"heavy: {sorted(%r & set(sys.modules))}")
"""
"""A program that runs the command and prints which of some modules it has imported."""


LEARNING = {"torch", "stable_baselines3", "sklearn"}
BRIEF = "deploy pretrained --robot hsr --no-real-time --backend analytic --goal 0.9 0.1 0.8"


@pytest.mark.parametrize(("words", "code", "heavy"), [
    ("--help", 0, {"numpy", "numba", "torch", "matplotlib", "rich"}),
    ("train --resume .", 2, {"torch"}),
    pytest.param(f"{BRIEF} --seconds 0.1", 4, LEARNING | {"matplotlib", "pybullet", "onnxruntime"},
                 marks=pytest.mark.slow),
])  # fmt: skip
def test_commands_import_nothing_heavy_that_they_do_not_need(
    tmp_path, monkeypatch, words, code, heavy
):
    monkeypatch.chdir(tmp_path)
    command = [sys.executable, "-c", HEAVY % heavy, *words.split()]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr.splitlines()[-1]) == (code, "heavy: []")


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


@pytest.mark.parametrize(("command", "called"), [
    ("ceiling", "kinfeas.api.evaluate.ceiling"),
    ("benchmark", "kinfeas.benchmark.evaluations.run_benchmark"),
])  # fmt: skip
def test_an_interrupted_command_says_so(kinfeas, monkeypatch, command, called):
    monkeypatch.setattr(called, Mock(side_effect=KeyboardInterrupt))
    assert kinfeas(command, code=130).err.startswith("interrupted")


def test_a_server_ends_by_an_interrupt(kinfeas, monkeypatch):
    called = "kinfeas.api.serve.PlanningServer.serve_forever"
    monkeypatch.setattr(called, Mock(side_effect=KeyboardInterrupt))
    assert kinfeas("serve", "--robot", "hsr", "--port", "0", code=0).err == ""


@pytest.mark.parametrize("error", [KeyError("x"), SystemExit(0)])
def test_errors_of_plugins_have_their_own_traceback_only(monkeypatch, capsys, error):
    def broken():
        raise error

    def app(**_):
        with plugin_note("adapter Mine"):
            broken()

    monkeypatch.setattr(module, "app", app)
    with pytest.raises(SystemExit) as end:
        module.main()
    printed = capsys.readouterr().err
    assert end.value.code == 2
    assert "in broken" in printed
    assert "in app" not in printed
    assert "adapter Mine" in printed.splitlines()[-1]


@pytest.mark.parametrize("words", [(), ("--help",), ("plugins", "--help"), ("--version",)])
def test_help_and_version_succeed(kinfeas, monkeypatch, words):
    monkeypatch.setenv("COLUMNS", "60")
    done = kinfeas(*words)
    assert (done.code, done.err) == (0, "")
    assert "kinfeas" in done.out
    assert "..." not in done.out.partition("Commands:")[2]  # no sentence is cut


@pytest.mark.parametrize("group", ["plugins", "robot"])
def test_a_group_without_a_command_prints_its_help(kinfeas, group):
    done = kinfeas(group, code=2)
    assert (done.out, done.err) == (kinfeas(group, "--help", code=0).out, "")
