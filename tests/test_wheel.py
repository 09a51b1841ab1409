"""What a user installs is whole: the wheel alone, in a fresh environment."""

import os
import shutil
import subprocess
import sys
import sysconfig
import tomllib
import venv
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

LOAD_ALL = """
import importlib.util, sys
from pathlib import Path
import kinfeas
from kinfeas.core import registry
from kinfeas.robots.loading import load_robot

assert Path(kinfeas.__file__).is_relative_to(sys.prefix), kinfeas.__file__
for bare in ("plugins", "scenes", "sim2real", "configs"):
    assert importlib.util.find_spec(bare) is None, bare
for group in registry.GROUPS:
    for plugin in registry.plugins(group):
        if plugin.distribution == "kinfeas":
            loaded = registry.load(group, plugin.name)
            print(group, plugin.name, sys.modules[loaded.__module__].__file__)
for robot in registry.names("kinfeas.robots"):
    print("robot", robot, load_robot(robot).name)
"""


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    """The wheel of the tree as it stands, built with the tools that are installed."""
    out = tmp_path_factory.mktemp("wheel")
    source = out / "source"
    copy_tree(source)
    run([sys.executable, "-m", "build", "--wheel", "--no-isolation", "-o", out, source])
    (built,) = out.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def environment(wheel, tmp_path_factory) -> Path:
    """A fresh environment with the wheel, which borrows the dependencies from this one."""
    folder = tmp_path_factory.mktemp("environment")
    venv.create(folder, with_pip=False, symlinks=True)
    python = folder / "bin" / "python"
    run([sys.executable, "-m", "pip", "--python", python, "install", "--no-deps", wheel])
    # A .pth file appends to the path, so the wheel comes first; it does not run the .pth files of
    # the borrowed folder, so an editable kinfeas there stays out.
    own = Path(
        run([python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"]).strip()
    )
    borrowed = {sysconfig.get_path("purelib"), sysconfig.get_path("platlib")}
    (own / "borrowed.pth").write_text("\n".join(borrowed))
    return folder


def copy_tree(target: Path) -> None:
    """Copy what the wheel is made of, so that no build folder appears in the tree itself."""
    for folder in ("kinfeas", "plugins", "scenes", "sim2real", "configs"):
        ignore = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / folder, target / folder, ignore=ignore)
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, target / name)


def run(command, cwd=None) -> str:
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    done = subprocess.run(
        [str(part) for part in command],
        cwd=cwd,
        env=environment,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    return done.stdout


def test_wheel_holds_the_data_beside_the_code(wheel):
    names = set(zipfile.ZipFile(wheel).namelist())
    in_tree = {
        *(ROOT / "kinfeas" / "robots").glob("*.yaml"),
        *(ROOT / "kinfeas" / "robots").glob("*.urdf"),
        *(ROOT / "kinfeas" / "tasks").glob("*.yaml"),
        *(ROOT / "kinfeas" / "templates").rglob("*.txt"),
        *(ROOT / "configs").rglob("*.yaml"),
        *(ROOT / "kinfeas" / "policies" / "pretrained").glob("*/policy.*"),
        *(ROOT / "plugins" / "models").glob("*.yaml"),
        *(ROOT / "scenes").glob("*.yaml"),
        ROOT / "kinfeas" / "py.typed",
    }
    for path in in_tree:
        name = path.relative_to(ROOT).as_posix()
        assert (
            f"kinfeas/{name}" if name.startswith(("configs/", "plugins/", "scenes/")) else name
        ) in names
    for robot in ("pr2", "tiago", "hsr"):
        assert {f"kinfeas/robots/{robot}.yaml", f"kinfeas/robots/{robot}.urdf"} <= names
    assert any(name.startswith("kinfeas/configs/robots/") for name in names)


def test_wheel_is_told_of_every_folder_with_modules():
    setup = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    folders = {"kinfeas": "kinfeas", **setup["package-dir"]}
    present = {
        ".".join((package, *path.parent.relative_to(ROOT / folder).parts))
        for package, folder in folders.items()
        for path in (ROOT / folder).rglob("*.py")
    }
    assert sorted(setup["packages"]) == sorted(present)


def test_wheel_leaks_no_other_top_level_name(wheel):
    names = zipfile.ZipFile(wheel).namelist()
    assert {name.split("/")[0] for name in names if ".dist-info/" not in name} == {"kinfeas"}


def test_every_entry_point_loads_from_the_wheel(environment, tmp_path):
    printed = run([environment / "bin" / "python", "-c", LOAD_ALL], cwd=tmp_path)
    lines = [line.split() for line in printed.splitlines()]
    entries = {(group, name): where for group, name, where in lines if group != "robot"}
    assert {
        ("kinfeas.motion_generators", "linear"),
        ("kinfeas.motion_generators", "imitation"),
        ("kinfeas.motion_generators", "gaussian_mixture"),
        ("kinfeas.robots", "pr2"),
        ("kinfeas.tasks", "ggr"),
        ("kinfeas.backends", "analytic"),
        ("kinfeas.adapters", "base_noise"),
    } <= entries.keys()
    assert all(Path(where).is_relative_to(environment) for where in entries.values())


def test_command_line_runs_from_the_wheel(environment, tmp_path):
    assert "train" in run([environment / "bin" / "kinfeas", "--help"], cwd=tmp_path)


def test_recipes_are_found_in_the_wheel(environment, tmp_path):
    code = "import importlib.resources as r; print((r.files('kinfeas.configs') / 'train').is_dir())"
    assert run([environment / "bin" / "python", "-c", code], cwd=tmp_path).strip() == "True"
