"""What the README and the pages of docs/ show works as it stands there."""

import importlib.util
import re
import shlex
from pathlib import Path

import numpy as np
import pytest
import typer

from kinfeas import registry
from kinfeas.cli.main import app
from kinfeas.kinematics.ik import IkSolver
from kinfeas.tasks.loading import load_task
from kinfeas.testing import check_motion_generator

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "README.md").read_text()
FENCED = re.findall(r"^```(\w*)\n(.*?)^```$", TEXT, re.MULTILINE | re.DOTALL)
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def commands(text):
    fenced = re.findall(r"^```\w*\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    lines = [line.split("  #")[0] for block in fenced for line in block.splitlines()]
    inline = re.findall(r"`(kinfeas [^`]+)`", re.sub(r"^```.*?^```$", "", text, flags=re.M | re.S))
    return {*(" ".join(line.split()) for line in inline), *lines}


COMMANDS = sorted(
    {line for page in PAGES for line in commands(page.read_text()) if line.startswith("kinfeas ")}
)


def test_there_are_commands():
    assert len(COMMANDS) > 10


@pytest.mark.parametrize("line", COMMANDS)
def test_every_command_parses(line, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    _, *arguments = shlex.split(line)
    if arguments[0].startswith("--"):
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


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_linked_file_exists(page):
    for path in re.findall(r"\]\((?!https?:)([^)#]+)\)", page.read_text()):
        assert (page.parent / path).is_file(), path


def test_the_task_of_the_page_on_tasks(tmp_path):
    page = (ROOT / "docs" / "tasks.md").read_text()
    path = tmp_path / "tidy_up.yaml"
    path.write_text(re.search(r"^```yaml\n(.*?)^```$", page, re.M | re.S).group(1))
    task = load_task(str(path))
    start = task.sample(IkSolver(registry.load_robot("pr2")), np.random.default_rng(0))
    assert start.target_poses.shape == (3, 7)
    assert [leg.wait for leg in task.legs] == [0.0, 2.0, 0.0]


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
