"""Plugins in distributions of their own: the example below `example_plugin`, and the templates."""

import json
import runpy
import shutil
import subprocess
import sys
import venv
from pathlib import Path

import pytest
from typer.testing import CliRunner

from kinfeas.cli.main import app
from kinfeas.config import registry
from kinfeas.core.errors import KinfeasError
from kinfeas.templates import Kind, write_distribution
from kinfeas.testing import check_motion_generator

EXAMPLE = Path(__file__).parent / "example_plugin"
MOTIONS = "kinfeas.motion_generators"
SHORT = ["--policy", "follow_ee", "--episodes", "2", "--set", "world.max_seconds=2.0"]


def kinfeas(*arguments):
    """Run a command; an exception that `main` would report is raised."""
    result = CliRunner().invoke(app, list(arguments))
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


def listed(path):
    """Return the rows of `plugins list` by name."""
    kinfeas("plugins", "list", "--json", str(path))
    return {row["name"]: row for row in json.loads(path.read_text())}


@pytest.fixture
def example(offer):
    offer(EXAMPLE)


def test_a_plugin_is_listed_checked_used_and_deployed(example, tmp_path):
    rows = listed(tmp_path / "plugins.json")
    for name in ("swirl", "roundabout"):
        assert (rows[name]["distribution"], rows[name]["version"]) == ("kinfeas-example", "1.2.3")
        assert rows[name]["description"]
    assert all(row["error"] is None for row in rows.values())
    check_motion_generator(registry.build(MOTIONS, "swirl", {}))
    assert kinfeas("plugins", "check", "swirl", "--set", "swirl=0.2").exit_code == 0

    motion = "task.motion={generator: swirl, parameters: {swirl: 0.2}}"
    assert "ggr" in kinfeas("evaluate", *SHORT, "--robot", "hsr", "--set", motion).output
    used = kinfeas("evaluate", "--robot", "hsr", "--task", "roundabout", *SHORT)
    assert "roundabout" in used.output

    record = tmp_path / "run.csv"
    goal = ["--generator", "swirl", "--goal", "1.5", "0", "0.8", "--set", "generator.swirl=0.2"]
    world = ["--backend", "analytic", "--no-real-time", "--seconds", "0.5"]
    result = kinfeas("deploy", "pretrained", *world, *goal, "--record", str(record))
    assert result.exit_code == 4, result.output  # not finished yet
    assert len(record.read_text().splitlines()) > 20


def test_a_broken_plugin_is_listed_with_its_error_and_affects_no_other(example, offer, tmp_path):
    (tmp_path / "pyproject.toml").write_text(
        f'[project]\nname = "broken"\nversion = "1"\n[project.entry-points."{MOTIONS}"]\n'
        'absent = "kinfeas_broken_absent:Absent"\nswirl = "kinfeas_rival:Swirl"\n'
    )
    offer(tmp_path)
    rows = listed(tmp_path / "a.json")
    assert {name for name, row in rows.items() if row["error"]} == {"absent", "swirl"}
    with pytest.raises(KinfeasError, match="broken and kinfeas-example"):
        kinfeas("plugins", "check", "swirl")
    assert kinfeas("plugins", "check", "linear").exit_code == 0


@pytest.mark.slow
def test_a_plugin_is_installed_and_uninstalled_by_pip(tmp_path, monkeypatch):
    # A copy, so that no build folder appears in the tree itself.
    shutil.copytree(EXAMPLE, tmp_path / "example", ignore=shutil.ignore_patterns("__pycache__"))
    venv.create(tmp_path / "venv", with_pip=False, symlinks=True)
    (site,) = (tmp_path / "venv").glob("lib/python*/site-packages")
    borrowed = [path for path in sys.path if path.endswith("site-packages")]
    (site / "borrowed.pth").write_text("\n".join(borrowed))

    def pip(*arguments):
        python = tmp_path / "venv" / "bin" / "python"
        subprocess.run([sys.executable, "-m", "pip", "--python", python, *arguments], check=True)

    pip("install", "--no-index", "--no-deps", "--no-build-isolation", tmp_path / "example")
    monkeypatch.syspath_prepend(str(site))
    assert "swirl" in registry.names(MOTIONS)
    assert len(registry.build("kinfeas.tasks", "roundabout", {}).subgoals) == 2
    pip("uninstall", "--yes", "kinfeas-example")
    assert "swirl" not in registry.names(MOTIONS)


@pytest.mark.parametrize("kind", Kind)
def test_each_template_passes_its_own_test(kind, tmp_path, offer):
    name = f"tried_{kind}"
    written = write_distribution(kind, name, tmp_path / "new")
    assert {path.suffix for path in written} >= {".toml", ".py", ".md"}
    assert all("$" not in path.read_text() for path in written)
    offer(tmp_path / "new")
    assert name in registry.names(kind.group)
    tests = runpy.run_path(str(tmp_path / "new" / f"test_{name}.py"))
    assert [function() for name, function in tests.items() if name.startswith("test_")]


@pytest.mark.parametrize(
    "name", ["My", "my-motion", "1st", "a__b", "_a", "a_", "class", "none", "linear"]
)
def test_names_that_are_invalid_or_taken_raise(name, tmp_path):
    with pytest.raises(KinfeasError, match=name):
        write_distribution("motion_generator", name, tmp_path / "new")
    assert not (tmp_path / "new").exists()
