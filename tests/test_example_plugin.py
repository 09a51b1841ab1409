"""A distribution from outside: installed, found, checked, used, uninstalled, gone."""

import json
import os
import shutil
import subprocess
import sys
import sysconfig
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


def run(command, **changes) -> str:
    done = subprocess.run(
        [str(part) for part in command],
        env={**os.environ, **changes},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    return done.stdout


def kinfeas(*arguments):
    """Run a command; an exception that `main` would report is raised."""
    result = CliRunner().invoke(app, list(arguments))
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


def message(*arguments) -> str:
    """Return the line that a command ends with in error."""
    with pytest.raises(KinfeasError) as caught:
        kinfeas(*arguments)
    assert "\n" not in str(caught.value)
    return str(caught.value)


class Environment:
    """A fresh environment for plugins, and what is installed there."""

    def __init__(self, folder: Path) -> None:
        self.python = folder / "bin" / "python"
        venv.create(folder, with_pip=False, symlinks=True)
        (self.site,) = folder.glob("lib/python*/site-packages")
        # What builds and what kinfeas stands on is borrowed from this environment.
        (self.site / "borrowed.pth").write_text(sysconfig.get_path("purelib"))

    def pip(self, *arguments) -> None:
        run([sys.executable, "-m", "pip", "--python", self.python, *arguments])


@pytest.fixture(scope="module")
def environment(tmp_path_factory) -> Environment:
    """A fresh environment with two distributions, one written by hand and one by `new`."""
    folder = tmp_path_factory.mktemp("environment")
    example, new = folder / "example", folder / "new"
    # A copy, so that no build folder appears in the tree itself.
    shutil.copytree(EXAMPLE, example, ignore=shutil.ignore_patterns("__pycache__", "build"))
    kinfeas("plugins", "new", "fresh_motion", "--out", str(new))
    made = Environment(folder / "venv")
    made.pip("install", "--no-index", "--no-deps", "--no-build-isolation", example, new)
    return made


@pytest.fixture
def installed(environment, monkeypatch) -> Environment:
    """The environment, its plugins within reach of this process."""
    monkeypatch.syspath_prepend(str(environment.site))
    return environment


def test_it_is_found_with_where_it_comes_from(installed, tmp_path):
    path = tmp_path / "plugins.json"
    kinfeas("plugins", "list", "--json", str(path))
    found = {(one["kind"], one["name"]): one for one in json.loads(path.read_text())}
    swirl, task = found["motion generator", "swirl"], found["task", "roundabout"]
    assert (swirl["distribution"], swirl["version"]) == ("kinfeas-example", "1.2.3")
    assert swirl["description"] == "To the target on a spiral about the vertical through it."
    assert task["description"] == "Go to a shelf and to a tray, each on a spiral."
    assert found["motion generator", "fresh_motion"]["distribution"] == "kinfeas-fresh-motion"
    assert all(one["error"] is None for one in found.values())


def test_it_passes_the_conformance_test(installed):
    check_motion_generator(registry.build(MOTIONS, "swirl", {}))
    result = kinfeas("plugins", "check", "swirl", "--set", "swirl=0.2")
    assert "motion generator swirl passes" in result.output


def test_its_parameters_are_checked(installed):
    text = message("plugins", "check", "swirl", "--set", "gain=-1")
    assert text.endswith("(kinfeas-example 1.2.3): gain must be positive, not -1")
    text = message("plugins", "check", "swirl", "--set", "gian=1")
    assert "motion generator 'swirl' (kinfeas-example 1.2.3): unknown parameter 'gian'" in text


def test_it_is_used(installed):
    motion = ["--set", "task.motion={generator: swirl, parameters: {swirl: 0.2}}"]
    assert "ggr, robot pr2" in " ".join(kinfeas("evaluate", *SHORT, *motion).output.split())
    result = kinfeas("evaluate", "--robot", "hsr", "--task", "roundabout", *SHORT)
    assert "roundabout, robot hsr" in " ".join(result.output.split())


def test_it_is_deployed(installed, tmp_path):
    record = tmp_path / "run.csv"
    goal = ["--generator", "swirl", "--goal", "1.5", "0", "0.8", "--set", "generator.swirl=0.2"]
    world = ["--backend", "analytic", "--no-real-time", "--seconds", "0.5"]
    result = kinfeas("deploy", "pretrained", *world, *goal, "--record", str(record))
    assert result.exit_code == 4, result.output  # not over yet
    assert len(record.read_text().splitlines()) > 20


def test_the_test_that_came_with_a_new_distribution_passes(installed, tmp_path):
    kinfeas("plugins", "new", "another", "--out", str(tmp_path / "new"))
    test = (tmp_path / "new" / "test_another.py").read_text().replace("another", "fresh_motion")
    (tmp_path / "test_fresh_motion.py").write_text(test)
    pytest_run = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", tmp_path]
    assert "1 passed" in run(
        [*pytest_run, "--ignore", tmp_path / "new"], PYTHONPATH=str(installed.site)
    )


BROKEN = """
    import numpy as np
    from kinfeas.core.spatial import twist_between

    class Sound:
        def start(self, ee_pose, target_pose, rngs):
            return {"goal": target_pose.copy()}

        def goal_pose(self, state, target_pose):
            return state["goal"]

        def twist(self, state, ee_pose, target_pose, dt):
            way = twist_between(ee_pose, state["goal"], dt)
            fastest = np.linalg.norm(way, axis=1, keepdims=True)
            return way * np.minimum(1.0, 0.099 / np.maximum(fastest, 1e-9)), state

    class WrongShape(Sound):
        def twist(self, state, ee_pose, target_pose, dt):
            return super().twist(state, ee_pose, target_pose, dt)[0][:, :3], state

    class NotANumber(Sound):
        def twist(self, state, ee_pose, target_pose, dt):
            return super().twist(state, ee_pose, target_pose, dt)[0] * np.nan, state

    class NotUnit(Sound):
        def goal_pose(self, state, target_pose):
            return state["goal"] * 2.0

    class InfiniteSpeed(Sound):
        def twist(self, state, ee_pose, target_pose, dt):
            return super().twist(state, ee_pose, target_pose, dt)[0] + np.inf, state

    class NeverArrives(Sound):
        def twist(self, state, ee_pose, target_pose, dt):
            return 0.01 * super().twist(state, ee_pose, target_pose, dt)[0], state

    class Raises(Sound):
        def twist(self, state, ee_pose, target_pose, dt):
            return state["gaol"], state
"""

# What `check` says, and what `evaluate` says if it notices at all.
FAULTS = {
    "WrongShape": ("twist", "(2, 6)"),
    "NotANumber": ("not finite", "not finite"),
    "NotUnit": ("goal_pose", "goal_pose"),
    "InfiniteSpeed": ("not finite", "not finite"),
    "Raises": ("KeyError: 'gaol' (kinfeas_broken.py, line 39)", None),
    "NeverArrives": ("m and ", None),
}


@pytest.fixture
def broken(offer, tmp_path):
    """A distribution of motion generators that are all broken but one."""
    folder = tmp_path / "broken"
    folder.mkdir()
    (folder / "kinfeas_broken.py").write_text(textwrap.dedent(BROKEN))
    entries = "".join(f'{name} = "kinfeas_broken:{name}"\n' for name in ["Sound", *FAULTS])
    (folder / "pyproject.toml").write_text(
        f'[project]\nname = "broken"\nversion = "1"\n[project.entry-points."{MOTIONS}"]\n{entries}'
        'absent = "kinfeas_broken_absent:Absent"\n'
    )
    offer(folder)


@pytest.mark.parametrize("name", FAULTS)
def test_each_fault_is_a_line_that_names_the_plugin(broken, name):
    in_check, in_evaluate = FAULTS[name]
    text = message("plugins", "check", name)
    assert text.split("broken: ")[1].startswith(f"motion generator {name} ")
    assert in_check in text
    if in_evaluate is not None:
        motion = ["--set", f"task.motion={{generator: {name}}}"]
        text = message("evaluate", *SHORT, *motion)
        assert text.startswith(f"motion generator {name} ")
        assert in_evaluate in text


def test_a_broken_plugin_disturbs_no_other(broken, tmp_path):
    path = tmp_path / "plugins.json"
    kinfeas("plugins", "list", "--json", str(path))
    errors = {one["name"]: one["error"] for one in json.loads(path.read_text()) if one["error"]}
    assert list(errors) == ["absent"]
    assert "(broken 1) cannot be loaded: ModuleNotFoundError" in errors["absent"]
    assert "passes" in kinfeas("plugins", "check", "Sound").output
    assert "motion generator 'absent' (broken 1) cannot" in message("plugins", "info", "absent")


def test_two_plugins_of_one_name_are_both_named(installed, offer, tmp_path):
    (tmp_path / "rival").mkdir()
    (tmp_path / "rival" / "pyproject.toml").write_text(
        f'[project]\nname = "rival"\nversion = "2"\n[project.entry-points."{MOTIONS}"]\n'
        'swirl = "kinfeas_rival:Swirl"\n'
    )
    offer(tmp_path / "rival")
    claimed = "motion generator 'swirl' is claimed by kinfeas-example and rival"
    for arguments in (["info", "swirl"], ["check", "swirl"]):
        assert claimed in message("plugins", *arguments)
    path = tmp_path / "plugins.json"
    kinfeas("plugins", "list", "--json", str(path))
    errors = {one["name"]: one["error"] for one in json.loads(path.read_text()) if one["error"]}
    assert list(errors) == ["swirl"]
    assert claimed in errors["swirl"]


def test_once_uninstalled_it_is_gone(installed):
    assert "swirl" in registry.names(MOTIONS)
    installed.pip("uninstall", "--yes", "kinfeas-example")
    assert "swirl" not in registry.names(MOTIONS)
    assert "fresh_motion" in registry.names(MOTIONS)
    text = message("evaluate", *SHORT, "--set", "task.motion={generator: swirl}")
    assert text.startswith("unknown motion generator 'swirl'")
