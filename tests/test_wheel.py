import os
import shutil
import subprocess
import sys
import venv
import zipfile
from functools import partial
from importlib.metadata import distribution
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[1]
FOLDERS = ("kinfeas", "plugins", "scenes", "sim2real", "configs")
SHIPPED = (".py", ".yaml", ".urdf", ".txt", ".json", ".safetensors", ".typed")

MESH_SHAPE = '<collision><geometry><mesh filename="a.stl"/></geometry></collision>'
ARM = "".join(
    f'<link name="l{i}">{MESH_SHAPE}</link><joint name="j{i}" type="revolute">'
    f'<parent link="{f"l{i - 1}" if i else "base"}"/><child link="l{i}"/><origin xyz="0 0 0.3"/>'
    '<axis xyz="0 1 0"/><limit lower="-2" upper="2" velocity="1" effort="9"/></joint>'
    for i in range(4)
)
MESH = f'<robot name="mesh"><link name="base">{MESH_SHAPE}</link>{ARM}</robot>'

LOAD_ALL = """
import importlib.util, sys
from pathlib import Path
from kinfeas.config.recipes import load_section
from kinfeas.config import registry
from kinfeas.robots.loading import load_robot
from kinfeas.training.config import TrainConfig

for bare in ("plugins", "scenes", "sim2real", "configs"):
    assert importlib.util.find_spec(bare) is None, bare
for group in registry.GROUPS:
    own = [plugin.name for plugin in registry.plugins(group) if plugin.distribution == "kinfeas"]
    assert own, group
    for name in own:
        loaded = registry.load(group, name)
        assert Path(sys.modules[loaded.__module__].__file__).is_relative_to(sys.prefix), name
for robot in registry.names("kinfeas.robots"):
    load_robot(robot)
    load_section(TrainConfig, "train", robot)
"""


def run(*command, cwd=None, code=0):
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    done = subprocess.run(
        command, cwd=cwd, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == code, f"{command}\n{done.stdout}\n{done.stderr}"
    return done.stdout if code == 0 else done.stderr


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wheel")
    source = folder / "source"
    for name in FOLDERS:  # a copy, so that no build folder appears in the tree
        shutil.copytree(ROOT / name, source / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE", "NOTICE"):
        shutil.copy(ROOT / name, source / name)
    run(sys.executable, "-m", "build", "--wheel", "--no-isolation", "-o", folder, source)
    return next(folder.glob("*.whl"))


@pytest.fixture
def home(wheel, tmp_path):
    venv.create(tmp_path / "home", with_pip=False, symlinks=True)
    python = tmp_path / "home" / "bin" / "python"
    run(sys.executable, "-m", "pip", "--python", python, "install", "--no-deps", wheel)
    return tmp_path / "home"


def site(home):
    code = "import sysconfig; print(sysconfig.get_path('purelib'))"
    return Path(run(home / "bin" / "python", "-c", code).strip())


@pytest.mark.slow
def test_wheel(wheel, home, tmp_path):
    names = {name for name in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in name}
    assert {name.split("/")[0] for name in names} == {"kinfeas"}
    for path in (path for folder in FOLDERS for path in (ROOT / folder).rglob("*")):
        if path.suffix in SHIPPED:
            assert (
                f"kinfeas/{path.relative_to(ROOT)}".replace("kinfeas/kinfeas", "kinfeas") in names
            )

    # A .pth file appends the dependencies of this environment, without its editable kinfeas.
    borrowed = [path for path in sys.path if path.endswith("-packages")]
    (site(home) / "borrowed.pth").write_text("\n".join(borrowed))
    run(home / "bin" / "python", "-c", LOAD_ALL, cwd=tmp_path)
    assert "train" in run(home / "bin" / "kinfeas", "--help", cwd=tmp_path)


def required(name, found):
    """Add a distribution and all that it requires, without extras, to `found`."""
    name = canonicalize_name(name)
    if name not in found:
        found[name] = distribution(name)
        for line in found[name].requires or ():
            requirement = Requirement(line)
            if requirement.marker is None or requirement.marker.evaluate({"extra": ""}):
                required(requirement.name, found)
    return found


EVALUATE = "evaluate --policy follow_ee --robot hsr --episodes 1 --set world.max_seconds=0.5"
DEPLOY = "deploy follow_ee --robot hsr --goal 0.9 0.1 0.8 --no-real-time --seconds 0.1"
LACKING = {
    "demo": "train,plots",
    "train --robot hsr --steps 64": "train",
    "sweep sweep/pr2": "train,plots,sweep",
    f"{EVALUATE} --picture a.png": "plots",
    f"{EVALUATE} --video a.mp4": "video,pybullet",
    f"{EVALUATE} --replay a.html": "view",
    "play --robot hsr": "view",
    "export pretrained --robot hsr --out a.onnx": "export",
    "evaluate --policy whole_body_qp --robot hsr --episodes 1": "qp",
    f"{EVALUATE} --world pybullet": "pybullet",
    DEPLOY: "pybullet",
    f"{DEPLOY} --backend ros2": "ros2",
    "robot import mesh.urdf --out out": "meshes",
    "dataset . --out out": "lerobot",
}
"""Commands, and the extras that an installation without extras lacks for them."""


@pytest.mark.slow
def test_base_installation_names_the_extra_that_a_command_lacks(home, tmp_path):
    for name, package in required("kinfeas", {}).items():
        for top in {path.parts[0] for path in package.files or () if name != "kinfeas"} - {".."}:
            (site(home) / top).symlink_to(package.locate_file(top))
    (tmp_path / "a.stl").touch()
    (tmp_path / "mesh.urdf").write_text(MESH)
    kinfeas = partial(run, home / "bin" / "kinfeas", cwd=tmp_path)
    kinfeas(*EVALUATE.split(), "--task", "door")
    kinfeas(*f"{DEPLOY} --backend analytic".split(), code=4)  # reached nothing in 0.1 s
    for words, extras in LACKING.items():
        (line,) = kinfeas(*words.split(), code=2).splitlines()
        assert line.endswith(f"pip install 'kinfeas[{extras}]'"), line
