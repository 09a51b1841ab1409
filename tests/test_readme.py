"""What the README shows works as it stands there."""

import importlib.util
import re
import shlex
from pathlib import Path

import pytest
import typer

from kinfeas.cli.main import app
from kinfeas.testing import check_motion_generator

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "README.md").read_text()
FENCED = re.findall(r"^```(\w*)\n(.*?)^```$", TEXT, re.MULTILINE | re.DOTALL)
INLINE = re.findall(r"`(kinfeas [^`]+)`", re.sub(r"^```.*?^```$", "", TEXT, flags=re.M | re.S))
LINES = [line.split("  #")[0] for _, block in FENCED for line in block.splitlines()]
COMMANDS = sorted({*INLINE, *(line for line in LINES if line.startswith("kinfeas "))})


def test_there_are_commands():
    assert len(COMMANDS) > 10


@pytest.mark.parametrize("line", COMMANDS)
def test_every_command_parses(line, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    _, *arguments = shlex.split(line)
    if arguments == ["--help"]:
        return
    command, name = typer.main.get_command(app), ""
    context = None
    while hasattr(command, "commands"):
        name, *arguments = arguments
        command = command.commands[name]
    with command.make_context(name, arguments, parent=context):
        pass


@pytest.mark.parametrize("target", re.findall(r"^make (\w+)", TEXT, re.MULTILINE))
def test_every_make_target_exists(target):
    assert re.search(rf"^{target}:", (ROOT / "Makefile").read_text(), re.MULTILINE)


def test_every_linked_file_exists():
    for path in re.findall(r"\]\((?!https?:)([^)#]+)\)", TEXT):
        assert (ROOT / path).is_file(), path


def test_pictures_are_small():
    for path in (ROOT / "docs" / "images").iterdir():
        assert path.stat().st_size < 300_000, path


def test_the_motion_generator_passes_the_conformance_test(tmp_path):
    code = next(block for kind, block in FENCED if kind == "python" and "@batched" in block)
    path = tmp_path / "arc.py"
    path.write_text(code)
    spec = importlib.util.spec_from_file_location("arc", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    check_motion_generator(module.Arc())


@pytest.mark.parametrize("code", [block for kind, block in FENCED if kind == "python"])
def test_python_compiles(code):
    compile(code, "README.md", "exec")
