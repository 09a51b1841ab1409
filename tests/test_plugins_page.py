"""The page on plugins works as it stands there: every block and every command, from top to end."""

import re
import runpy
import shlex
from pathlib import Path

import pytest
from typer.testing import CliRunner

from kinfeas.cli.main import app
from kinfeas.core import registry
from kinfeas.robots.loading import load_robot, read_robot
from kinfeas.templates.distribution import write_distribution
from kinfeas.testing import check_motion_generator

PAGE = (Path(__file__).parents[1] / "docs" / "plugins.md").read_text()
BLOCKS = re.findall(r"^```(\w*)\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)
FILES = {block.split("\n")[0].removeprefix("# "): block for kind, block in BLOCKS if kind}
COMMANDS = [shlex.split(line) for kind, block in BLOCKS if not kind for line in block.splitlines()]
# Enough to see that they run; the last word on an option counts.
SHORTER = {
    "evaluate": ["--episodes", "2", "--set", "world.max_seconds=2.0"],
    "ceiling": ["--episodes", "2"],
}
HOURS = "train"  # takes minutes, and what comes after it needs what it learned
OWN_CODE = 30  # lines that a first motion generator may take


def kinfeas(*arguments):
    result = CliRunner().invoke(app, list(arguments))
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert result.exit_code == 0, result.output
    return result.output


@pytest.fixture
def followed(tmp_path, monkeypatch, offer):
    """Whoever followed the page so far: distributions begun, installed and written into."""
    monkeypatch.chdir(tmp_path)
    for words in COMMANDS:
        if words[:3] == ["kinfeas", "plugins", "new"]:
            kinfeas(*words[1:])
    for name, text in FILES.items():
        Path(name).parent.mkdir(parents=True, exist_ok=True)
        Path(name).write_text(text)
    for project in sorted(tmp_path.glob("*/pyproject.toml")):
        offer(project.parent)


def test_every_block_says_which_file_it_is():
    assert all(name.endswith((".py", ".yaml", ".toml")) for name in FILES)
    assert len(FILES) == sum(kind != "" for kind, _ in BLOCKS) >= 8


def test_a_first_motion_generator_is_short():
    lines = [line for line in FILES["arc/kinfeas_arc/arc.py"].splitlines() if line.strip()]
    assert len(lines) - 1 <= OWN_CODE


@pytest.mark.parametrize("file", ["porter.yaml", "porter.py"])
def test_the_robot_is_the_one_that_new_writes(tmp_path, file):
    write_distribution("robot", "porter", tmp_path)
    written = (tmp_path / "kinfeas_porter" / file).read_text()
    assert written.endswith(FILES[f"porter/kinfeas_porter/{file}"].partition("\n")[2])


def test_every_command_runs(followed):
    for program, *words in COMMANDS:
        if program == "pip":
            assert Path(words[-1], "pyproject.toml").is_file()
        elif words[:2] != ["plugins", "new"] and words[0] != HOURS and "runs/porter" not in words:
            assert kinfeas(*words, *SHORTER.get(words[0], []))
    assert Path("arc.png").read_bytes().startswith(b"\x89PNG")


def test_what_the_blocks_offer_does_what_the_page_says(followed):
    for name in ("arc", "fast_arc"):
        check_motion_generator(registry.build("kinfeas.motion_generators", name, {}))
    assert load_robot("porter").base.drive == "differential"
    assert read_robot(Path("porter/kinfeas_porter/porter.yaml")).name == "porter"
    for path in (*Path().glob("*/test_*.py"), Path("use_lagging.py")):
        for name, thing in runpy.run_path(str(path)).items():
            if name.startswith("test_"):
                thing()
