"""What the README and the pages of docs/ show works as it stands there."""

import json
import re
import shlex
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
import typer
from markdown_it import MarkdownIt

from kinfeas import config
from kinfeas.cli.examples import EXAMPLES
from kinfeas.cli.main import app
from kinfeas.config.recipes import default_recipe
from kinfeas.kinematics.ik import IkSolver
from kinfeas.robots.loading import load_robot
from kinfeas.sim2real.ros.names import read_topics
from kinfeas.tasks.loading import load_task
from kinfeas.testing import check_motion_generator
from kinfeas.training.config import TrainConfig

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "README.md").read_text()
TRAINING = (ROOT / "docs" / "training.md").read_text()
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
# Whose Python blocks another test runs, since they need files or stand in a row.
RUN_ELSEWHERE = {
    "demonstrations.md": "io/test_demonstrations.py",
    "export.md": "sim2real/test_export.py",
    "plugins.md": "test_plugins_page.py",
    "ros.md": "sim2real/test_udp_example.py",
    "sim2real.md": "sim2real/test_docs.py",
}


def tokens(text):
    return MarkdownIt().parse(text)


def blocks(text):
    """Return kind and contents of each block of code, fenced or indented."""
    return [(one.info, one.content) for one in tokens(text) if one.type in ("fence", "code_block")]


def shown(text):
    """Return the commands in blocks, a line each; a backslash continues one."""
    lines = "".join(code for _, code in blocks(text)).replace("\\\n", " ").splitlines()
    whole = {" ".join(line.split("  #")[0].split()) for line in lines}
    return {line for line in whole if line.startswith("kinfeas ")}


def mentioned(text):
    """Return the commands in the midst of sentences."""
    spans = [
        span for one in tokens(text) for span in one.children or () if span.type == "code_inline"
    ]
    found = {" ".join(span.content.split()) for span in spans}
    return {line for line in found if line.startswith("kinfeas ")}


SHOWN = {line for page in PAGES for line in shown(page.read_text())}
SHOWN |= {line for lines in EXAMPLES.values() for line in lines}
COMMANDS = sorted(SHOWN.union(*(mentioned(page.read_text()) for page in PAGES)))
PYTHON = [
    pytest.param(code, id=f"{page.stem}-{number}")
    for page in PAGES
    if page.name not in RUN_ELSEWHERE
    for number, (kind, code) in enumerate(blocks(page.read_text()))
    if kind == "python"
]


def test_there_are_commands():
    assert len(COMMANDS) > 10


@pytest.mark.parametrize("line", COMMANDS)
def test_every_command_parses(line, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "plugins" / "models").mkdir(parents=True)  # as in the project's root
    _, *arguments = shlex.split(line)
    if arguments[0].startswith("--"):
        return
    command, name = typer.main.get_command(app), ""
    context = None
    while hasattr(command, "commands"):
        name, *arguments = arguments
        command = command.commands[name]
    names_option = len(arguments) == 1 and arguments[0].startswith("--")
    if line not in SHOWN and (names_option or not arguments):  # no call, but what it is called
        assert set(arguments) <= {name for one in command.params for name in one.opts}
        return
    with command.make_context(name, arguments, parent=context):
        pass


@pytest.mark.parametrize("target", re.findall(r"^make (\w+)", TEXT, re.MULTILINE))
def test_every_make_target_exists(target):
    assert re.search(rf"^{target}:", (ROOT / "Makefile").read_text(), re.MULTILINE)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_linked_file_exists(page):
    for path in re.findall(r"\]\((?!https?:)([^)#]+)[^)]*\)", page.read_text()):
        assert (page.parent / path).is_file(), path


def test_the_task_of_the_page_on_tasks(tmp_path):
    page = (ROOT / "docs" / "tasks.md").read_text()
    path = tmp_path / "tidy_up.yaml"
    path.write_text(re.search(r"^```yaml\n(.*?)^```$", page, re.M | re.S).group(1))
    task = load_task(str(path))
    start = task.sample(IkSolver(load_robot("pr2")), np.random.default_rng(0))
    assert start.target_poses.shape == (3, 7)
    assert [subgoal.dwell for subgoal in task.subgoals] == [0.0, 2.0, 0.0]


def test_the_topics_of_the_page_on_ros_are_those_of_tiago(tmp_path):
    page = (ROOT / "docs" / "ros.md").read_text()
    path = tmp_path / "mine.yaml"
    path.write_text(re.search(r"^```yaml\n(.*?)^```$", page, re.M | re.S).group(1))
    tiago = load_robot("tiago")
    assert read_topics(tiago, 2, str(path)) == read_topics(tiago, 2)


ROWS = re.findall(r"^\| `(\S+)` \| (\S.*?) \| (\S.*?) \| (\S.*?) \|", TRAINING, re.M)


@pytest.mark.parametrize(("key", "other", "pr2", "tiago"), ROWS)
def test_the_recipes_of_the_page_on_training(key, other, pr2, tiago):
    def value(robot):
        known = asdict(config.load(TrainConfig, default_recipe("train", robot)))
        for part in key.split("."):
            known = known[part]
        return list(known) if isinstance(known, tuple) else known

    if key in {"world.reward", "world.adapters"}:
        assert (pr2, tiago) == ("the same", "the same")
        return
    told = [float(text) if "[" not in text else json.loads(text) for text in (other, pr2, tiago)]
    assert told == [value(robot) for robot in ("none", "pr2", "tiago")]
    assert value("hsr") == told[1]


def test_pictures_are_small():
    for path in (ROOT / "docs" / "images").iterdir():
        most = 1_000_000 if path.suffix == ".gif" else 300_000
        assert path.stat().st_size < most, path


def test_a_page_that_is_run_elsewhere_is_run_there():
    for page, test in RUN_ELSEWHERE.items():
        assert page in (ROOT / "tests" / test).read_text()


def test_the_motion_generator_passes_the_conformance_test(tmp_path):
    code = next(code for kind, code in blocks(TEXT) if kind == "python" and "@batched" in code)
    names = {}
    exec(compile(code, "README.md", "exec"), names)
    check_motion_generator(names["Arc"]())


@pytest.mark.parametrize("code", PYTHON)
def test_python_runs(code, tmp_path, monkeypatch):
    if "kinfeas_arc" in code:
        pytest.skip("needs the installed example; test_plugins_page.py has it")
    monkeypatch.chdir(tmp_path)
    shorter = code.replace("100_000", "256").replace("), 128)", "), 4)")
    exec(compile(shorter, "docs", "exec"), {"__name__": "page"})


def test_every_command_has_an_example():
    def names(command, before=""):
        for name, inner in command.commands.items():
            whole = f"{before} {name}".strip()
            yield from names(inner, whole) if hasattr(inner, "commands") else (whole,)

    assert set(names(typer.main.get_command(app))) == set(EXAMPLES)
    for name, lines in EXAMPLES.items():
        assert all(line.startswith(f"kinfeas {name}") for line in lines)
