import re
import subprocess
import sys

import pytest
import typer
from typer.testing import CliRunner

from kinfeas import __version__
from kinfeas.cli import main as module
from kinfeas.core.errors import KinfeasError

HEAVY = {"numpy", "numba", "scipy", "torch", "gymnasium", "matplotlib", "pybullet", "onnxruntime"}
HELP = f"""
import sys
from kinfeas.cli.main import app, main
names = [command.name for command in app.registered_commands]
groups = [["plugins"], ["plugins", "check"], ["robot"], ["robot", "import"]]
for words in [[], *([name] for name in names), *groups]:
    sys.argv = ["kinfeas", *words, "--help"]
    try:
        main()
    except SystemExit as end:
        assert end.code == 0, words
print("of", len(names), "loaded:", sorted({HEAVY} & set(sys.modules)))
"""


def kinfeas(*arguments):
    code = "from kinfeas.cli.main import main; main()"
    return subprocess.run(
        [sys.executable, "-c", code, *arguments], capture_output=True, text=True, check=False
    )


def test_no_help_imports_anything_heavy():
    done = subprocess.run([sys.executable, "-c", HELP], capture_output=True, text=True, check=True)
    assert "evaluate" in done.stdout
    assert "--guards" in done.stdout
    assert done.stdout.endswith("of 11 loaded: []\n")


def commands(command, words=""):
    """Yield every command by the words that it is called with."""
    yield words, command
    for name, inner in getattr(command, "commands", {}).items():
        yield from commands(inner, f"{words} {name}".strip())


COMMANDS = dict(commands(typer.main.get_command(module.app)))


def test_no_help_breaks_a_paragraph():
    assert {"", "evaluate", "plugins", "plugins check"} <= COMMANDS.keys()
    for words, command in COMMANDS.items():
        assert "\n" not in command.help.replace("\n\n", ""), words


def test_no_help_shows_a_value_behind_a_flag(monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    for words in COMMANDS:
        shown = CliRunner().invoke(module.app, [*words.split(), "--help"]).output
        assert re.search(r"--help +Show this message", shown), words
        assert "<bool>" not in shown, words


def test_version():
    done = kinfeas("--version")
    assert done.stdout == f"kinfeas {__version__}\n"
    assert done.returncode == 0


def test_runs_as_a_module():
    command = [sys.executable, "-m", "kinfeas", "--version"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout == f"kinfeas {__version__}\n"


def test_bad_input_is_one_line_and_exit_code_2():
    done = kinfeas("ceiling", "--robot", "pr3")
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.startswith("error: unknown robot 'pr3' (did you mean 'pr2'?)")
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize("words", ["ceiling", "evaluate --policy pretrained", "speed", "train"])
def test_an_unknown_robot_is_refused_before_anything_is_loaded_for_it(words):
    code = """
import sys
from kinfeas.cli.main import main
try:
    main()
finally:
    print({"kinfeas.evaluation", "kinfeas.sim2real", "kinfeas.training"} & set(sys.modules))
"""
    command = [sys.executable, "-c", code, *words.split(), "--robot", "pr3"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.stdout == "set()\n"
    assert done.stderr.startswith("error: unknown robot 'pr3'")


@pytest.mark.parametrize("arguments", [["evaluat"], ["ceiling", "--episodes", "none"]])
def test_wrong_usage_exits_with_2(arguments):
    done = kinfeas(*arguments)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr


def raising(error):
    def app(**_):
        raise error

    return app


def test_an_error_of_many_lines_becomes_one(monkeypatch, capsys):
    monkeypatch.setattr(module, "app", raising(KinfeasError("first\n  second")))
    with pytest.raises(SystemExit) as end:
        module.main()
    assert end.value.code == 2
    assert capsys.readouterr().err == "error: first second\n"


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (PermissionError(13, "Permission denied", "/locked/a.yaml"), "/locked/a.yaml: Permission"),
        (OSError(28, "No space left on device"), "No space left on device"),
        (OSError("gone"), "gone"),
    ],
)
def test_what_the_system_refuses_is_one_line(monkeypatch, capsys, error, message):
    monkeypatch.setattr(module, "app", raising(error))
    with pytest.raises(SystemExit) as end:
        module.main()
    assert end.value.code == 2
    assert capsys.readouterr().err.startswith(f"error: {message}")


@pytest.mark.parametrize(
    "words",
    [
        ["evaluate", "--policy", "x" * 5000],
        ["evaluate", "--policy", "follow_ee", "--robot", f"{'x' * 5000}.yaml"],
        ["export", "--check", "x" * 5000],
        ["train", "--resume", "x" * 5000],
        ["train", "--config", "x" * 5000],
        ["view", "--record", "x" * 5000],
    ],
)
def test_a_path_that_is_too_long_is_one_line(monkeypatch, capsys, words):
    monkeypatch.setattr("sys.argv", ["kinfeas", *words])
    with pytest.raises(SystemExit) as end:
        module.main()
    assert end.value.code == 2
    message = capsys.readouterr().err
    assert message.endswith(": File name too long\n")
    assert message.count("\n") == 1


def test_ctrl_c_exits_with_130(monkeypatch):
    monkeypatch.setattr(module, "app", raising(KeyboardInterrupt))
    with pytest.raises(SystemExit) as end:
        module.main()
    assert end.value.code == 130


def test_our_own_mistakes_keep_their_traceback(monkeypatch):
    monkeypatch.setattr(module, "app", raising(ZeroDivisionError))
    with pytest.raises(ZeroDivisionError):
        module.main()


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["evaluate", "--policy", "follow_ee", "--episodes", "0"], "--episodes"),
        (["evaluate", "--nope"], "--nope"),
        (["evaluate"], "--policy"),
        (["fly"], "fly"),
    ],
)
def test_wrong_usage_is_one_line(monkeypatch, capsys, words, named):
    monkeypatch.setattr("sys.argv", ["kinfeas", *words])
    with pytest.raises(SystemExit) as end:
        module.main()
    message = capsys.readouterr().err
    assert end.value.code == 2
    assert message.startswith("error: ")
    assert named in message
    assert message.count("\n") == 1


@pytest.mark.parametrize("words", [[], ["--help"], ["--version"]])
def test_help_and_version_succeed(monkeypatch, capsys, words):
    monkeypatch.setattr("sys.argv", ["kinfeas", *words])
    with pytest.raises(SystemExit) as end:
        module.main()
    assert end.value.code == 0
    assert "kinfeas" in capsys.readouterr().out
