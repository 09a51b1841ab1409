import re
import sys
import textwrap
import tomllib
from importlib.util import find_spec
from pathlib import Path

import pytest

from kinfeas.core import registry
from kinfeas.core.errors import KinfeasError
from kinfeas.core.extras import EXTRAS, require
from kinfeas.core.registry import Plugin

MOTIONS, ROBOTS = "kinfeas.motion_generators", "kinfeas.robots"

SOUND = """
    from dataclasses import dataclass
    from pathlib import Path

    @dataclass(frozen=True)
    class Shape:
        width: float = 1.0
        ends: tuple[float, float] = (0.0, 1.0)

    class Shaped:
        def __init__(self, shape: Shape | None = None, *, file: Path = Path("x")):
            self.kept = (shape, file)

    class Wave:
        def __init__(self, height, *, width=1.0):
            if height < 0.0:
                raise ValueError(f"height must be positive, not {height}")
            self.size = (height, width)

    class Lenient:
        def __init__(
            self, lag: float = 0.1, *, count: "int" = 1, name: str = "", on: bool = False,
            ends: float | tuple[float, float] = 0.0, file: Path | None = None, rest: float = None,
            table: dict[int, float] | None = None, shape: "Unknown" = None,
        ):
            self.kept = (lag, count, name, on, ends, file, rest)

    def anything(**parameters):
        return parameters

    NUMBER = 3

    def my_robot():
        return Path(__file__).with_name("my_robot.yaml")
"""


@pytest.fixture
def install(tmp_path, monkeypatch):
    def make(name: str, module: str, source: str, entries: dict[str, list[str]]) -> None:
        site = tmp_path / name
        info = site / f"{name}-1.2.dist-info"
        info.mkdir(parents=True)
        (site / f"{module}.py").write_text(textwrap.dedent(source))
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.2\n")
        lines = [line for group, rows in entries.items() for line in (f"[{group}]", *rows)]
        (info / "entry_points.txt").write_text("\n".join(lines))
        monkeypatch.delitem(sys.modules, module, raising=False)
        monkeypatch.syspath_prepend(str(site))

    return make


@pytest.fixture
def sound(install):
    motions = ["wave = sound_module:Wave", "any = sound_module:anything"]
    motions += ["lenient = sound_module:Lenient", "shaped = sound_module:Shaped"]
    motions += ["number = sound_module:NUMBER", "absent = sound_module:Absent"]
    robots = ["mine = sound_module:my_robot"]
    install("sound", "sound_module", SOUND, {MOTIONS: motions, "kinfeas.robots": robots})


def message(call, *arguments) -> str:
    with pytest.raises(KinfeasError) as caught:
        call(*arguments)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_built_in_and_outside_plugins_are_listed(sound):
    names = registry.names(MOTIONS)
    assert {"linear", "wave"} <= set(names)
    assert names == sorted(names)
    assert {"pr2", "tiago", "hsr", "mine"} <= set(registry.names(ROBOTS))
    plugin = Plugin(MOTIONS, "wave", "sound", "1.2")
    assert plugin in registry.plugins(MOTIONS)
    assert str(plugin) == "motion generator 'wave' (sound 1.2)"


def test_unknown_names_and_groups(sound):
    text = message(registry.load, MOTIONS, "wav")
    assert "'wav'" in text
    assert "'wave'" in text
    assert "linear" in text
    assert "'kinfeas.robot'" in message(registry.names, "kinfeas.robot")


@pytest.mark.parametrize(("name", "parameters", "key"), [
    ("wave", {"hight": 1}, "'hight' .did you mean 'height'.*known are height"),
    ("wave", {}, "height"),
    ("wave", {"height": -1}, "height must be positive, not -1"),
    ("wave", {"height": "x"}, "str"),
    ("lenient", {"lag": "x"}, "lag"),
    ("lenient", {"ends": [1.0, "x"]}, "ends"),
    ("shaped", {"shape": {"end": 1}}, r"shape\.end"),
    ("number", {}, "int"),
    ("absent", {}, "Absent"),
])  # fmt: skip
def test_invalid_parameters_name_plugin_and_key(sound, name, parameters, key):
    text = message(registry.build, MOTIONS, name, parameters)
    assert text.startswith(f"motion generator '{name}' (sound 1.2)")
    assert re.search(key, text)


def test_parameters_are_converted_to_their_annotations(sound):
    given = {"lag": 1, "count": 2, "ends": [1, 2], "file": "a", "rest": None, "shape": [1]}
    built = registry.build(MOTIONS, "lenient", {**given, "table": {1: 2.0}})
    assert built.kept == (1, 2, "", False, (1, 2), Path("a"), None)
    given = {"shape": {"ends": [1, 2]}, "file": "a.yaml"}
    shape, file = registry.build(MOTIONS, "shaped", given).kept
    assert (shape.width, shape.ends, file) == (1.0, (1.0, 2.0), Path("a.yaml"))
    assert given == {"shape": {"ends": [1, 2]}, "file": "a.yaml"}


class Hop:
    pass


@pytest.fixture
def registered(monkeypatch):
    monkeypatch.setattr(registry, "_REGISTERED", [])
    registry.register(MOTIONS, "hop", Hop)


def test_register_raises_for_used_names_inner_classes_and_unknown_groups(registered):
    class Inner:
        pass

    assert "'linear'" in message(registry.register, MOTIONS, "linear", Hop)
    assert "Inner" in message(registry.register, MOTIONS, "inner", Inner)
    assert "lambda" in message(registry.register, MOTIONS, "lambda", lambda: Hop())
    assert "kinfeas.hops" in message(registry.register, "kinfeas.hops", "hop", Hop)


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
