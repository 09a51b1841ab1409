import sys
import tomllib
from importlib.util import find_spec
from pathlib import Path

import pytest

from kinfeas.core import registry
from kinfeas.core.errors import KinfeasError
from kinfeas.core.extras import EXTRAS, missing_extra, require
from kinfeas.robots.loading import load_robot

PROJECT = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]


def test_the_extras_are_those_of_the_distribution():
    distribution = set(PROJECT["optional-dependencies"])
    assert set(EXTRAS) == distribution - {"all", "docs", "test", "dev"}


def test_missing_packages_are_named_with_their_extras(monkeypatch):
    monkeypatch.setattr(
        "kinfeas.core.extras.find_spec",
        lambda name: None if name in ("torch", "av") else find_spec(name),
    )
    require("numpy")
    with pytest.raises(KinfeasError, match=r"'kinfeas\[train,video\]'"):
        require("torch", "numpy", "av")


def test_other_import_errors_are_no_missing_extras():
    assert missing_extra(ModuleNotFoundError(name="torch.nn")) is not None
    assert missing_extra(ModuleNotFoundError(name="of_a_plugin")) is None
    assert missing_extra(ImportError(name="torch")) is None


def test_plugins_name_the_extra(monkeypatch):
    for name in ["cyclonedds", *(one for one in sys.modules if one.startswith("cyclonedds."))]:
        monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.delitem(sys.modules, "kinfeas.sim2real.ros.ros2", raising=False)
    with pytest.raises(KinfeasError, match=r"kinfeas\[ros2\]"):
        registry.build("kinfeas.backends", "ros2", {"robot": load_robot("pr2")})
