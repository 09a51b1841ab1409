"""Fixtures and settings that all tests share."""

import os
import signal
import sys
import tomllib
from pathlib import Path

# Before anything imports them: one thread a library, and no display.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("MPLBACKEND", "Agg")

import pytest
from hypothesis import settings

from kinfeas.config import registry
from kinfeas.kinematics.ik import IkSolver
from kinfeas.robots.loading import load_robot

# Numba compiles within the first example, and a busy machine takes long over any.
settings.register_profile("kinfeas", deadline=None, derandomize=True)
settings.load_profile("kinfeas")


@pytest.fixture(autouse=True)
def in_the_foreground():
    """Let signals through that processes ignore under nohup or in the background of a shell."""
    handlers = {signal.SIGINT: signal.default_int_handler, signal.SIGHUP: lambda *_: None}
    ignored = [number for number in handlers if signal.getsignal(number) is signal.SIG_IGN]
    for number in ignored:
        signal.signal(number, handlers[number])
    yield
    for number in ignored:
        signal.signal(number, signal.SIG_IGN)


@pytest.fixture(scope="session", params=["pr2", "tiago", "hsr"])
def robot(request):
    return load_robot(request.param)


@pytest.fixture(scope="session")
def pr2():
    return load_robot("pr2")


@pytest.fixture(scope="session")
def hsr():
    return load_robot("hsr")


@pytest.fixture(scope="session")
def solver(robot):
    return IkSolver(robot)


@pytest.fixture(scope="module", params=["pybullet", "mujoco"])
def engine(request):
    pytest.importorskip(request.param)
    return request.param


@pytest.fixture
def unregistered(monkeypatch):
    """Take what a test registers out of the registry afterwards."""
    monkeypatch.setattr(registry, "_REGISTERED", [])


@pytest.fixture
def offer(tmp_path, monkeypatch):
    """A function that makes the distribution of a folder known, as an installation would."""

    def make(folder: Path) -> None:
        project = tomllib.loads((folder / "pyproject.toml").read_text())["project"]
        name, version = project["name"], project["version"]
        site = tmp_path / "site" / name
        info = site / f"{name.replace('-', '_')}-{version}.dist-info"
        info.mkdir(parents=True)
        metadata = f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n"
        (info / "METADATA").write_text(metadata)
        lines = []
        for group, entries in project["entry-points"].items():
            lines += [f"[{group}]", *(f"{key} = {value}" for key, value in entries.items())]
        (info / "entry_points.txt").write_text("\n".join(lines))
        for path in (site, folder):
            monkeypatch.syspath_prepend(str(path))

    before = set(sys.modules)
    yield make
    for fresh in set(sys.modules) - before:
        if fresh.startswith("kinfeas_"):
            del sys.modules[fresh]
