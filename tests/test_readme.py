import contextlib
import json
import os
import re
import runpy
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
import typer
from markdown_it import MarkdownIt

from kinfeas.cli.main import app
from kinfeas.core.errors import KinfeasError
from kinfeas.tasks.loading import load_task
from kinfeas.testing import check_motion_generator

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
RECORDS = ("study", "physics", "mujoco")
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(DOCS.rglob("*.md"))]
# Pages with Python blocks that need files; their tests are beside the code.
BLOCKS_TESTED_ELSEWHERE = {"demonstrations.md", "plugins.md"}


def blocks(text):
    """Return kind and contents of each block of code, fenced or indented."""
    tokens = MarkdownIt().parse(text)
    return [(one.info, one.content) for one in tokens if one.type in ("fence", "code_block")]


def commands(text):
    """Return the commands in blocks, a line each; a backslash continues one."""
    lines = "".join(code for _, code in blocks(text)).replace("\\\n", " ").splitlines()
    whole = {" ".join(line.split("  #")[0].split()) for line in lines}
    return {line for line in whole if re.match(r"kinfeas [a-z]", line)}


def examples(command):
    own = re.findall(r"Example: (kinfeas .*)", command.help or "")
    inner = getattr(command, "commands", {}).values()
    return [*own, *(line for one in inner for line in examples(one))]


COMMANDS = {line for page in PAGES for line in commands(page.read_text())}
COMMANDS |= set(examples(typer.main.get_command(app)))
PYTHON = [
    pytest.param(code, id=f"{page.stem}-{number}")
    for page in PAGES
    if page.name not in BLOCKS_TESTED_ELSEWHERE
    for number, (kind, code) in enumerate(blocks(page.read_text()))
    if kind == "python"
]


def resolved(line):
    """Return the name, the command and the other arguments of a line."""
    command, name = typer.main.get_command(app), ""
    arguments = shlex.split(line)[1:]
    while hasattr(command, "commands"):
        name, *arguments = arguments
        command = command.commands[name]
    return name, command, arguments


@pytest.mark.parametrize("line", sorted(COMMANDS))
def test_every_command_parses(line, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "plugins" / "models").mkdir(parents=True)  # as in the project's root
    name, command, arguments = resolved(line)
    # Runs, files and plugins of the examples do not exist here.
    with contextlib.suppress(KinfeasError), command.make_context(name, arguments):
        pass


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_options_in_sentences(page):
    for line in re.findall(r"`(kinfeas [a-z][^`]*)`", page.read_text()):
        _, command, arguments = resolved(line)
        options = {
            name
            for parameter in command.params
            for name in parameter.opts + parameter.secondary_opts
        }
        assert {one for one in arguments if one.startswith("--")} <= options, line


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links(page):
    text = page.read_text()
    for path in re.findall(r"\]\((?!https?:)([^)#]+)[^)]*\)", text):
        assert (page.parent / path).is_file(), path
    for target in re.findall(r"^make ([\w-]+)", text, re.MULTILINE):
        assert re.search(rf"^{target}:", (ROOT / "Makefile").read_text(), re.MULTILINE)


@pytest.mark.parametrize("code", PYTHON)
def test_python_runs(code, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shorter = code.replace("100_000", "256").replace(
        '_episodes": 20', '_episodes": 2, "schedule.final_episodes": 4'
    )
    names = {"__name__": "page"}
    exec(compile(shorter, "docs", "exec"), names)
    if "Arc" in names:
        check_motion_generator(names["Arc"]())


def test_task_of_the_page_on_tasks(tmp_path):
    path = tmp_path / "page.yaml"
    path.write_text(dict(reversed(blocks((DOCS / "tasks.md").read_text())))["yaml"])
    task = load_task(str(path))
    assert [subgoal.dwell for subgoal in task.subgoals] == [0.0, 2.0, 0.0]


def test_the_pages_hold_what_the_record_says():
    script = runpy.run_path(str(DOCS / "results_tables.py"))
    study, bullet, mujoco = (
        json.loads((DOCS / f"figures/{one}.json").read_text()) for one in RECORDS
    )
    tables, physics = (DOCS / "reference/tables.md").read_text(), (DOCS / "physics.md").read_text()
    assert script["tables_page"](study, bullet, mujoco) == tables
    readme = (ROOT / "README.md").read_text()
    assert script["fill_readme"](readme, study, bullet) == readme
    assert script["fill_physics"](physics, bullet, mujoco) == physics


def test_the_reference_is_current():
    script = runpy.run_path(str(DOCS / "reference_pages.py"))
    for page in sorted((DOCS / "reference").glob("*.md")):
        assert script["filled"](page.read_text()) == page.read_text(), f"{page}: make reference"


@pytest.mark.slow
def test_the_site(tmp_path):
    for package in ("sphinx", "myst_parser", "furo", "sphinx_copybutton"):
        pytest.importorskip(package, reason='pip install "kinfeas[docs]"')
    options = ["--fail-on-warning", "--keep-going", "--quiet", "--doctree-dir", tmp_path / "trees"]
    done = subprocess.run(
        [sys.executable, "-m", "sphinx", *options, DOCS, tmp_path / "site"],
        capture_output=True, text=True, env={**os.environ, "PYTHONWARNINGS": "ignore"}, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    for page in DOCS.rglob("*.md"):
        assert (tmp_path / "site" / page.relative_to(DOCS).with_suffix(".html")).is_file()
