import re
import runpy
import shlex
from pathlib import Path

import pytest
from typer.testing import CliRunner

from kinfeas.cli.main import app
from kinfeas.core import registry
from kinfeas.testing import check_motion_generator

PAGE = (Path(__file__).parents[1] / "docs" / "plugins.md").read_text()
BLOCKS = re.findall(r"^```(\w*)\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)
FILES = {text.split("\n")[0].removeprefix("# "): text for kind, text in BLOCKS if kind == "python"}
COMMANDS = [shlex.split(line) for kind, text in BLOCKS if not kind for line in text.splitlines()]
SHORTER = {
    "evaluate": ["--episodes", "2", "--set", "world.max_seconds=2.0"],
    "ceiling": ["--episodes", "2"],
}


def run(*arguments):
    result = CliRunner().invoke(app, list(arguments), catch_exceptions=False)
    assert result.exit_code == 0, result.output


@pytest.fixture
def packages(tmp_path, monkeypatch, offer):
    """Packages that the commands write, with the code of the page, installed."""
    monkeypatch.chdir(tmp_path)
    for words in COMMANDS:
        if words[:3] == ["kinfeas", "plugins", "new"]:
            run(*words[1:])
    for name, text in FILES.items():
        Path(name).write_text(text)
    for project in sorted(tmp_path.glob("*/pyproject.toml")):
        offer(project.parent)


@pytest.mark.slow
def test_the_page(packages):
    for program, *words in COMMANDS:
        if program == "kinfeas" and words[:2] != ["plugins", "new"]:
            run(*words, *SHORTER.get(words[0], []))
    assert Path("arc.png").read_bytes().startswith(b"\x89PNG")
    check_motion_generator(registry.build("kinfeas.motion_generators", "arc", {}))
    for name, thing in runpy.run_path("arc/test_arc.py").items():
        if name.startswith("test_"):
            thing()
