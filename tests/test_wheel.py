"""The wheel alone, in a fresh environment, has all modules, data and entry points."""

import os
import shutil
import subprocess
import sys
import tomllib
import venv
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FOLDERS = ("kinfeas", "plugins", "scenes", "sim2real", "configs")
DATA = (".yaml", ".urdf", ".txt", ".json", ".safetensors", ".typed")

LOAD_ALL = """
import importlib.util, sys
from pathlib import Path
from kinfeas.config.recipes import load_section
from kinfeas.core import registry
from kinfeas.robots.loading import load_robot
from kinfeas.training.config import TrainConfig

for bare in ("plugins", "scenes", "sim2real", "configs"):
    assert importlib.util.find_spec(bare) is None, bare
for group in registry.GROUPS:
    own = [one.name for one in registry.plugins(group) if one.distribution == "kinfeas"]
    assert own, group
    for name in own:
        loaded = registry.load(group, name)
        assert Path(sys.modules[loaded.__module__].__file__).is_relative_to(sys.prefix), name
for robot in ("pr2", "tiago", "hsr"):
    load_robot(robot)
    load_section(TrainConfig, "train", robot)
"""


def run(*command, cwd=None):
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    done = subprocess.run(
        command, cwd=cwd, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    return done.stdout


def test_pyproject_lists_every_package():
    setup = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    folders = {"kinfeas": "kinfeas", **setup["package-dir"]}
    present = {
        ".".join((package, *path.parent.relative_to(ROOT / folder).parts))
        for package, folder in folders.items()
        for path in (ROOT / folder).rglob("*.py")
    }
    assert sorted(setup["packages"]) == sorted(present)


@pytest.mark.slow
def test_wheel(tmp_path):
    source, home = tmp_path / "source", tmp_path / "home"
    for folder in FOLDERS:  # a copy, so that no build folder appears in the tree
        ignored = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / folder, source / folder, ignore=ignored)
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source / name)
    run(sys.executable, "-m", "build", "--wheel", "--no-isolation", "-o", tmp_path, source)
    (wheel,) = tmp_path.glob("*.whl")

    names = {name for name in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in name}
    assert {name.split("/")[0] for name in names} == {"kinfeas"}
    for path in (path for folder in FOLDERS for path in (ROOT / folder).rglob("*")):
        if path.suffix in DATA:
            assert (
                f"kinfeas/{path.relative_to(ROOT)}".replace("kinfeas/kinfeas", "kinfeas") in names
            )

    venv.create(home, with_pip=False, symlinks=True)
    python = home / "bin" / "python"
    run(sys.executable, "-m", "pip", "--python", python, "install", "--no-deps", wheel)
    # A .pth file appends the dependencies of this environment, without its editable kinfeas.
    site = run(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))").strip()
    borrowed = [path for path in sys.path if path.endswith("-packages")]
    Path(site, "borrowed.pth").write_text("\n".join(borrowed))
    run(python, "-c", LOAD_ALL, cwd=tmp_path)
    assert "train" in run(home / "bin" / "kinfeas", "--help", cwd=tmp_path)
