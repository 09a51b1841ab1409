import re
import textwrap
import tomllib
from pathlib import Path

import pytest

from kinfeas.config import registry
from kinfeas.core.errors import KinfeasError
from kinfeas.core.extras import EXTRAS
from kinfeas.plugins.linear import Linear

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

    class Lenient:
        def __init__(
            self, lag: float = 0.1, *, count: "int" = 1, name: str = "", on: bool = False,
            ends: float | tuple[float, float] = 0.0, file: Path | None = None, rest: float = None,
            table: dict[int, float] | None = None, shape: "Unknown" = None,
        ):
            self.kept = (lag, count, name, on, ends, file, rest)

    NUMBER = 3

    def my_robot():
        return Path(__file__).with_name("my_robot.yaml")
"""
ENTRIES = {"wave": "Wave", "lenient": "Lenient", "shaped": "Shaped", "number": "NUMBER"}
PROJECT = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]


@pytest.fixture
def sound(offer, tmp_path):
    """Install a distribution with motion generators and a robot."""
    (tmp_path / "kinfeas_sound.py").write_text(textwrap.dedent(SOUND))
    entries = "\n".join(
        f'{name} = "kinfeas_sound:{member}"'
        for name, member in {**ENTRIES, "absent": "Absent"}.items()
    )
    (tmp_path / "pyproject.toml").write_text(
        f'[project]\nname = "sound"\nversion = "1.2"\n[project.entry-points."{MOTIONS}"]\n'
        f'{entries}\n[project.entry-points."{ROBOTS}"]\nmine = "kinfeas_sound:my_robot"\n'
    )
    offer(tmp_path)


def message(call, *arguments) -> str:
    with pytest.raises(KinfeasError) as caught:
        call(*arguments)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize(("name", "parameters", "key"), [
    ("wave", {"hight": 1}, "'hight' .did you mean 'height'.*known are height"),
    ("wave", {}, "height"),
    ("wave", {"height": -1}, "height must be positive, not -1"),
    ("lenient", {"ends": [1.0, "x"]}, "ends"),
    ("shaped", {"shape": {"end": 1}}, r"shape\.end"),
    ("number", {}, "int"),
    ("absent", {}, "Absent"),
])  # fmt: skip
def test_errors_of_parameters_name_plugin_and_key(sound, name, parameters, key):
    text = message(registry.build, MOTIONS, name, parameters)
    assert text.startswith(f"motion generator '{name}' (sound 1.2)")
    assert re.search(key, text)


def test_parameters_are_converted_to_their_annotations(sound):
    values = {"lag": 1, "count": 2, "ends": [1, 2], "file": "a", "rest": None, "shape": [1]}
    built = registry.build(MOTIONS, "lenient", {**values, "table": {1: 2.0}})
    assert built.kept == (1, 2, "", False, (1, 2), Path("a"), None)
    values = {"shape": {"ends": [1, 2]}, "file": "a.yaml"}
    shape, file = registry.build(MOTIONS, "shaped", values).kept
    assert (shape.width, shape.ends, file) == (1.0, (1.0, 2.0), Path("a.yaml"))
    assert values == {"shape": {"ends": [1, 2]}, "file": "a.yaml"}


def test_the_own_plugin_of_a_name_is_used_with_a_warning(offer, tmp_path):
    (tmp_path / "pyproject.toml").write_text(
        f'[project]\nname = "rival"\nversion = "1"\n[project.entry-points."{MOTIONS}"]\n'
        'linear = "kinfeas_rival:Linear"\n'
    )
    offer(tmp_path)
    with pytest.warns(UserWarning, match="'linear' of rival is ignored"):
        assert registry.load(MOTIONS, "linear") is Linear


@pytest.mark.parametrize("group", [ROBOTS, "kinfeas.tasks"])
def test_names_that_files_hold_run_no_code(group):
    assert "os:getcwd" in message(registry.build, group, "os:getcwd", {})


class Hop:
    pass


def test_names_are_registered_once_in_known_groups_by_top_level_classes(unregistered):
    class Inner:
        pass

    registry.register(MOTIONS, "hop", Hop)
    assert registry.load(MOTIONS, "hop") is Hop
    for group, name, factory, word in (
        (MOTIONS, "linear", Hop, "'linear'"),
        (MOTIONS, "inner", Inner, "Inner"),
        (MOTIONS, "lambda", lambda: Hop(), "lambda"),
        ("kinfeas.hops", "hop", Hop, "kinfeas.hops"),
    ):
        assert word in message(registry.register, group, name, factory)


def test_the_extras_are_those_of_the_distribution():
    extras = set(PROJECT["optional-dependencies"]) - {"all", "docs", "test", "dev"}
    assert set(EXTRAS) == extras
