"""A distribution of its own: found, checked, used and deployed; installed and uninstalled."""

import json
import shutil
import subprocess
import sys
import textwrap
import venv
from pathlib import Path

import pytest
from typer.testing import CliRunner

from kinfeas.cli.main import app
from kinfeas.core import registry
from kinfeas.core.errors import KinfeasError
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
    return {one["name"]: one for one in json.loads(path.read_text())}


@pytest.fixture
def example(offer):
    offer(EXAMPLE)


def test_it_is_listed_and_passes_the_conformance_check(example, tmp_path):
    found = listed(tmp_path / "plugins.json")
    for name in ("swirl", "roundabout"):
        assert (found[name]["distribution"], found[name]["version"]) == ("kinfeas-example", "1.2.3")
        assert found[name]["description"]
    assert all(one["error"] is None for one in found.values())
    check_motion_generator(registry.build(MOTIONS, "swirl", {}))
    assert kinfeas("plugins", "check", "swirl", "--set", "swirl=0.2").exit_code == 0


@pytest.mark.parametrize(("setting", "named"), [("gain=-1", "gain"), ("gian=1", "'gian'")])
def test_its_parameters_are_checked(example, setting, named):
    with pytest.raises(KinfeasError, match=rf"kinfeas-example 1\.2\.3.*{named}"):
        kinfeas("plugins", "check", "swirl", "--set", setting)


def test_it_is_used_and_deployed(example, tmp_path):
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


BROKEN = """
    import numpy as np
    from kinfeas.core.spatial import twist_between

    class Sound:
        def start(self, ee_pose, target_pose, rngs):
            return {}

        def goal_pose(self, state, target_pose):
            return target_pose.copy()

        def twist(self, state, ee_pose, target_pose, dt):
            way = twist_between(ee_pose, target_pose, dt)
            fastest = np.linalg.norm(way, axis=1, keepdims=True)
            return way * np.minimum(1.0, 0.099 / np.maximum(fastest, 1e-9)), state

    class WrongShape(Sound):
        def twist(self, *given):
            return super().twist(*given)[0][:, :3], given[0]

    class NotANumber(Sound):
        def twist(self, *given):
            return super().twist(*given)[0] * np.nan, given[0]

    class NotUnit(Sound):
        def goal_pose(self, state, target_pose):
            return target_pose * 2.0

    class NeverArrives(Sound):
        def twist(self, *given):
            return 0.01 * super().twist(*given)[0], given[0]

    class Raises(Sound):
        def twist(self, *given):
            return given[0]["gaol"], given[0]
"""
FAULTS = ("WrongShape", "NotANumber", "NotUnit", "NeverArrives", "Raises")


@pytest.fixture
def broken(offer, tmp_path):
    """A distribution of motion generators that are all broken but one."""
    folder = tmp_path / "broken"
    folder.mkdir()
    (folder / "kinfeas_broken.py").write_text(textwrap.dedent(BROKEN))
    entries = "".join(f'{name} = "kinfeas_broken:{name}"\n' for name in ("Sound", *FAULTS))
    (folder / "pyproject.toml").write_text(
        f'[project]\nname = "broken"\nversion = "1"\n[project.entry-points."{MOTIONS}"]\n{entries}'
        'absent = "kinfeas_broken_absent:Absent"\n'
    )
    offer(folder)


def test_faults_name_the_plugin_and_disturb_no_other(broken, tmp_path):
    for name in FAULTS:
        commands = [["plugins", "check", name]]
        if name != "NeverArrives":  # an evaluation cannot tell
            motion = f"task.motion={{generator: {name}}}"
            commands.append(["evaluate", "--robot", "hsr", *SHORT, "--set", motion])
        for command in commands:
            with pytest.raises((KinfeasError, KeyError)) as caught:
                kinfeas(*command)
            assert name in " ".join([str(caught.value), *getattr(caught.value, "__notes__", [])])
    errors = {name: one["error"] for name, one in listed(tmp_path / "a.json").items()}
    assert [name for name, error in errors.items() if error] == ["absent"]
    assert kinfeas("plugins", "check", "Sound").exit_code == 0


def test_two_plugins_of_one_name_are_both_named(example, offer, tmp_path):
    (tmp_path / "rival").mkdir()
    (tmp_path / "rival" / "pyproject.toml").write_text(
        f'[project]\nname = "rival"\nversion = "2"\n[project.entry-points."{MOTIONS}"]\n'
        'swirl = "kinfeas_rival:Swirl"\n'
    )
    offer(tmp_path / "rival")
    with pytest.raises(KinfeasError, match="kinfeas-example and rival"):
        kinfeas("plugins", "check", "swirl")
    errors = {name: one["error"] for name, one in listed(tmp_path / "a.json").items()}
    assert [name for name, error in errors.items() if error] == ["swirl"]


@pytest.mark.slow
def test_it_is_installed_and_uninstalled_by_pip(tmp_path, monkeypatch):
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
