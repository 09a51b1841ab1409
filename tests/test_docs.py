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
from typer.testing import CliRunner

from kinfeas.cli.main import app
from kinfeas.config import registry
from kinfeas.core.errors import KinfeasError
from kinfeas.tasks.loading import load_task
from kinfeas.testing import check_motion_generator

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(DOCS.rglob("*.md"))]
COMMAND = typer.main.get_command(app)
# Pages whose Python needs files: `test_the_page_on_plugins`, and those of tests/plugins.
NEED_FILES = {"demonstrations.md", "plugins.md"}


def blocks(page):
    """Return kind and contents of each block of code, fenced or indented."""
    tokens = MarkdownIt().parse(page.read_text())
    return [
        (token.info, token.content) for token in tokens if token.type in ("fence", "code_block")
    ]


def commands(page):
    """Return the commands in blocks, a line each; a backslash continues one."""
    lines = "".join(code for _, code in blocks(page)).replace("\\\n", " ").splitlines()
    whole = {" ".join(line.split("  #")[0].split()) for line in lines}
    return {line for line in whole if re.match(r"kinfeas [a-z]", line)}


def examples(command):
    """Return the examples in the help of a command and of those below it."""
    own = re.findall(r"Example: (kinfeas .*)", command.help or "")
    below = getattr(command, "commands", {}).values()
    return [*own, *(line for inner in below for line in examples(inner))]


def resolved(line):
    """Return the name, the command and the other arguments of a line."""
    command, name = COMMAND, ""
    arguments = shlex.split(line)[1:]
    while hasattr(command, "commands"):
        name, *arguments = arguments
        command = command.commands[name]
    return name, command, arguments


@pytest.mark.parametrize("line", sorted({*examples(COMMAND)}.union(*map(commands, PAGES))))
def test_every_command_parses(line, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "plugins" / "models").mkdir(parents=True)  # as in the project's root
    name, command, arguments = resolved(line)
    # Runs, files and plugins of the examples do not exist here.
    with contextlib.suppress(KinfeasError), command.make_context(name, arguments):
        pass


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_options_links_and_targets_exist(page):
    text = page.read_text()
    for line in re.findall(r"`(kinfeas [a-z][^`]*)`", text):
        _, command, arguments = resolved(line)
        options = {name for one in command.params for name in one.opts + one.secondary_opts}
        assert {word for word in arguments if word.startswith("--")} <= options, line
    for path in re.findall(r"\]\((?!https?:)([^)#]+)[^)]*\)", text):
        assert (page.parent / path).is_file(), path
    for target in re.findall(r"^make ([\w-]+)", text, re.MULTILINE):
        assert re.search(rf"^{target}:", (ROOT / "Makefile").read_text(), re.MULTILINE)


@pytest.mark.parametrize("code", [
    pytest.param(code, id=f"{page.stem}-{number}")
    for page in PAGES
    if page.name not in NEED_FILES
    for number, (kind, code) in enumerate(blocks(page))
    if kind == "python"
])  # fmt: skip
def test_python_runs(code, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shorter = code.replace("100_000", "4_000").replace(
        '_episodes": 20', '_episodes": 2, "schedule.final_episodes": 4'
    )
    names = {"__name__": "page"}
    exec(compile(shorter, "docs", "exec"), names)
    if "Arc" in names:
        check_motion_generator(names["Arc"]())


def test_task_of_the_page_on_tasks(tmp_path):
    path = tmp_path / "page.yaml"
    path.write_text(dict(reversed(blocks(DOCS / "tasks.md")))["yaml"])
    assert [subgoal.dwell for subgoal in load_task(str(path)).subgoals] == [0.0, 2.0, 0.0]


SHORTER = {
    "evaluate": ["--episodes", "2", "--set", "world.max_seconds=2.0"],
    "ceiling": ["--episodes", "2"],
}


@pytest.mark.slow
def test_the_page_on_plugins(tmp_path, monkeypatch, offer):
    """The packages that its commands write, with its code, are installed and used."""
    monkeypatch.chdir(tmp_path)
    page = blocks(DOCS / "plugins.md")
    lines = [shlex.split(line) for kind, code in page if not kind for line in code.splitlines()]
    new = [line for line in lines if line[:3] == ["kinfeas", "plugins", "new"]]

    def run(words):
        result = CliRunner().invoke(app, words[1:], catch_exceptions=False)
        assert result.exit_code == 0, result.output

    for words in new:
        run(words)
    for code in (code for kind, code in page if kind == "python"):
        Path(code.split("\n")[0].removeprefix("# ")).write_text(code)
    for project in sorted(tmp_path.glob("*/pyproject.toml")):
        offer(project.parent)
    for words in lines:
        if words[0] == "kinfeas" and words not in new:
            run([*words, *SHORTER.get(words[1], [])])
    assert Path("arc.png").read_bytes().startswith(b"\x89PNG")
    check_motion_generator(registry.build("kinfeas.motion_generators", "arc", {}))
    for name, function in runpy.run_path("arc/test_arc.py").items():
        if name.startswith("test_"):
            function()


def test_tables_are_those_of_the_records():
    script = runpy.run_path(str(DOCS / "results_tables.py"))
    study, bullet, mujoco = (
        json.loads((DOCS / f"figures/{name}.json").read_text())
        for name in ("study", "physics", "mujoco")
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
