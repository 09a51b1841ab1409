import sys
import textwrap
from pathlib import Path

import pytest

from kinfeas.core import registry
from kinfeas.core.errors import KinfeasError
from kinfeas.core.registry import Plugin
from kinfeas.robots.loading import load_robot

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

    class Typed:
        def __init__(self, height: float, shape: slice = slice(1)):
            if height < 0.0:
                raise ValueError(f"height must be positive, not {height}")
            self.size = shape + "of a type that no file can hold"

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

    def no_path():
        return "my_robot.yaml"
"""


@pytest.fixture
def install(tmp_path, monkeypatch):
    """A function that makes a distribution of one module and puts it on the path."""

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
    """A distribution of plugins that work."""
    motions = ["wave = sound_module:Wave", "any = sound_module:anything"]
    motions += ["typed = sound_module:Typed"]
    motions += ["lenient = sound_module:Lenient", "shaped = sound_module:Shaped"]
    motions += ["number = sound_module:NUMBER", "absent = sound_module:Absent"]
    robots = ["mine = sound_module:my_robot", "text = sound_module:no_path"]
    install("sound", "sound_module", SOUND, {MOTIONS: motions, "kinfeas.robots": robots})


def message(call, *arguments) -> str:
    with pytest.raises(KinfeasError) as caught:
        call(*arguments)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_built_in_and_outside_plugins_stand_side_by_side(sound):
    assert {"linear", "wave"} <= set(registry.names(MOTIONS))
    assert {"pr2", "tiago", "hsr", "mine"} <= set(registry.names("kinfeas.robots"))
    assert Plugin(MOTIONS, "wave", "sound", "1.2") in registry.plugins(MOTIONS)
    assert registry.names(MOTIONS) == sorted(registry.names(MOTIONS))


def test_plugin_reads_well():
    plugin = Plugin(MOTIONS, "wave", "sound", "1.2")
    assert str(plugin) == "motion generator 'wave' (sound 1.2)"


def test_load_and_build(sound):
    assert registry.load(MOTIONS, "wave").__name__ == "Wave"
    assert registry.build(MOTIONS, "wave", {"height": 2.0}).size == (2.0, 1.0)
    assert registry.build(MOTIONS, "wave", {"height": 2.0, "width": 3.0}).size == (2.0, 3.0)
    assert registry.build(MOTIONS, "any", {"x": 1}) == {"x": 1}


def test_unknown_name_lists_what_there_is(sound):
    text = message(registry.load, MOTIONS, "wav")
    assert text.startswith("unknown motion generator 'wav' (did you mean 'wave'?); known are ")
    assert "linear" in text
    assert message(load_robot, "pr3").startswith("unknown robot 'pr3' (did you mean 'pr2'")


def test_unknown_group():
    assert message(registry.names, "kinfeas.robot").startswith("unknown plugin group")


@pytest.mark.parametrize(
    ("name", "parameters", "expected"),
    [
        ("wave", {"hight": 1}, "unknown parameter 'hight' (did you mean 'height'?); known are"),
        ("wave", {"height": 1, "self": 2}, "unknown parameter 'self'; known are height, width"),
        ("wave", {}, "the parameter 'height' is missing; known are height, width"),
        ("wave", {"height": -1}, "height must be positive, not -1"),
        ("wave", {"height": "x"}, "'<' not supported between instances of 'str' and 'float'"),
        ("typed", {"height": "x"}, "'height'"),
        ("lenient", {"lag": "x"}, "'lag'"),
        ("lenient", {"lag": None}, "'lag'"),
        ("lenient", {"lag": True}, "'lag'"),
        ("lenient", {"name": 3}, "'name'"),
        ("lenient", {"on": "yes"}, "'on'"),
        ("lenient", {"ends": [1.0, "x"]}, "'ends'"),
        ("lenient", {"file": 3}, "'file'"),
        ("typed", {"height": 1.0, "shape": 2}, "unsupported operand type(s) for +: 'int' and "),
    ],
)
def test_build_refuses_parameters(sound, name, parameters, expected):
    text = message(registry.build, MOTIONS, name, parameters)
    assert text.startswith(f"motion generator '{name}' (sound 1.2): {expected}")


def test_annotated_parameters_may_be_all_that_they_could_be(sound):
    given = {"lag": 1, "count": 2, "ends": [1, 2], "file": "a", "rest": None, "shape": [1]}
    built = registry.build(MOTIONS, "lenient", {**given, "table": {1: 2.0}})
    assert built.kept == (1, 2, "", False, (1, 2), Path("a"), None)
    assert registry.build(MOTIONS, "lenient", {"lag": float("inf")}).kept[0] == float("inf")


def test_parameters_come_in_the_types_that_they_are_annotated_with(sound):
    given = {"shape": {"ends": [1, 2]}, "file": "a.yaml"}
    shape, file = registry.build(MOTIONS, "shaped", given).kept
    assert (shape.width, shape.ends, file) == (1.0, (1.0, 2.0), Path("a.yaml"))
    assert given == {"shape": {"ends": [1, 2]}, "file": "a.yaml"}
    assert "not -1" in message(registry.build, MOTIONS, "typed", {"height": -1})
    text = message(registry.build, MOTIONS, "shaped", {"shape": {"end": 1}})
    assert "unknown key 'shape.end' (did you mean 'ends'?)" in text


def test_types_that_are_written_as_text_are_known(install):
    source = """
        from __future__ import annotations
        class Late:
            def __init__(self, lag: float = 0.1, *, first: int | None = None):
                pass
    """
    install("late", "late_module", source, {MOTIONS: ["late = late_module:Late"]})
    assert registry.build(MOTIONS, "late", {"lag": 1, "first": None})
    text = message(registry.build, MOTIONS, "late", {"lag": "x"})
    assert text.startswith("motion generator 'late' (late 1.2): 'lag'")


@pytest.mark.parametrize(
    ("kind", "methods"),
    [("tasks", "sample"), ("adapters", "reset, step, close"), ("backends", "reset, step, close")],
)
def test_what_is_built_must_be_of_its_kind(install, kind, methods):
    group = f"kinfeas.{kind}"
    source = "def nothing():\n    pass"
    install("empty", "empty_module", source, {group: ["nothing = empty_module:nothing"]})
    text = message(registry.build, group, "nothing", {})
    sentence = f"must return an object with the methods {methods}, not NoneType"
    assert text == f"{registry.GROUPS[group]} 'nothing' (empty 1.2) {sentence}"


def test_build_refuses_what_cannot_be_called(sound):
    text = message(registry.build, MOTIONS, "number", {})
    assert text == "motion generator 'number' (sound 1.2) must be a class or a function, not int"


@pytest.mark.parametrize(
    ("source", "cause"),
    [
        ("import surely_no_such_module", "ModuleNotFoundError: No module named"),
        ("def f(:", "SyntaxError: invalid syntax"),
        ("1 / 0", "ZeroDivisionError: division by zero"),
        ("raise RuntimeError('no licence')", "RuntimeError: no licence"),
        ("x = undefined", "NameError: name 'undefined'"),
        ("open('/no/such/file')", "FileNotFoundError"),
        ("pass", "AttributeError: module 'broken_module' has no attribute 'Broken'"),
    ],
)
def test_broken_plugin_names_itself_and_disturbs_no_other(sound, install, source, cause):
    install("broken", "broken_module", source, {MOTIONS: ["bad = broken_module:Broken"]})
    text = message(registry.load, MOTIONS, "bad")
    assert text.startswith(f"motion generator 'bad' (broken 1.2) cannot be loaded: {cause}")
    assert "bad" in registry.names(MOTIONS)
    assert registry.load(MOTIONS, "wave").__name__ == "Wave"
    assert registry.load(MOTIONS, "linear").__name__ == "Linear"


@pytest.mark.parametrize("target", ["", "broken-module:Broken", "broken_module.Broken()"])
def test_an_entry_point_to_nothing_says_what_it_must_be(install, target):
    install("broken", "broken_module", "", {MOTIONS: [f"bad = {target}"]})
    text = message(registry.build, MOTIONS, "bad", {})
    cause = f"its entry point must be module:name, not {target!r}"
    assert text == f"motion generator 'bad' (broken 1.2) cannot be loaded: {cause}"


def test_a_distribution_that_was_half_removed_disturbs_nobody(install, tmp_path):
    install("half", "half_module", "class Wave: pass", {MOTIONS: ["wave = half_module:Wave"]})
    (tmp_path / "half" / "half-1.2.dist-info" / "METADATA").unlink()
    [found] = [plugin for plugin in registry.plugins(MOTIONS) if plugin.name == "wave"]
    assert str(found) == "motion generator 'wave' (? ?)"
    install("rival", "rival_module", "Wave = int", {MOTIONS: ["wave = rival_module:Wave"]})
    assert "is claimed by ? and rival" in message(registry.load, MOTIONS, "wave")


def test_name_claimed_twice_names_both(sound, install):
    install("rival", "rival_module", "Wave = int", {MOTIONS: ["wave = rival_module:Wave"]})
    text = message(registry.load, MOTIONS, "wave")
    assert text == "motion generator 'wave' is claimed by rival and sound; uninstall all but one"
    assert registry.names(MOTIONS).count("wave") == 1
    assert len([plugin for plugin in registry.plugins(MOTIONS) if plugin.name == "wave"]) == 2
    assert registry.load(MOTIONS, "any")


@pytest.mark.parametrize("name", ["pr2", "tiago", "hsr"])
def test_load_robot_by_name_and_by_file_alike(name):
    by_name = load_robot(name)
    path = Path(registry.load("kinfeas.robots", name)())
    assert by_name.name == load_robot(str(path)).name == name
    assert load_robot(path).name == name


@pytest.mark.parametrize("use", [load_robot, lambda name: registry.load(ROBOTS, name)])
@pytest.mark.parametrize("name", [None, 3, ["pr2"]])
def test_what_is_no_name_is_refused_with_what_is_allowed(use, name):
    with pytest.raises(KinfeasError, match=r"robot must be one of .*pr2.* or the path of .*, not"):
        use(name)


@pytest.mark.parametrize("name", ["absent.yaml", "absent.yml", "./pr2", "some/robot"])
def test_load_robot_takes_a_path_for_a_file(name):
    assert name.removeprefix("./") in message(load_robot, name)
    assert "unknown robot" not in message(load_robot, name)


@pytest.mark.parametrize(
    ("name", "way"),
    [
        ("scout.urdf", "which kinfeas robot import scout.urdf --out FOLDER writes"),
        ("./my bot.URDF", "which kinfeas robot import 'my bot.URDF' --out FOLDER writes"),
        (
            "bots/a.urdf.xacro",
            "which xacro bots/a.urdf.xacro > bots/a.urdf and then kinfeas robot import bots/",
        ),
        (
            "a.xacro",
            "which xacro a.xacro > a.urdf and then kinfeas robot import a.urdf --out FOLDER",
        ),
    ],
)
def test_a_urdf_in_place_of_the_yaml_is_told_the_way(name, way):
    assert f"a robot is a YAML file, {way}" in message(load_robot, name)


def test_load_robot_reads_the_file_that_an_outside_plugin_names(sound):
    assert "my_robot.yaml" in message(load_robot, "mine")
    assert message(load_robot, "text") == (
        "robot 'text' must return the Path of its YAML, not 'my_robot.yaml'"
    )


OWN_ERRORS = """
    class LicenceError(Exception):
        pass

    class Costly:
        def __init__(self):
            raise LicenceError("expired")

    def forgetful():
        return {}["key"]
"""


def test_whatever_a_plugin_raises_names_it(install):
    entries = ["costly = costly_module:Costly", "forgetful = costly_module:forgetful"]
    install("costly", "costly_module", OWN_ERRORS, {MOTIONS: entries})
    text = message(registry.build, MOTIONS, "costly", {})
    assert text == (
        "motion generator 'costly' (costly 1.2) fails: LicenceError: expired "
        "(costly_module.py, line 7)"
    )
    assert "'forgetful' (costly 1.2) fails: KeyError: 'key'" in message(
        registry.build, MOTIONS, "forgetful", {}
    )
    with pytest.raises(KinfeasError, match="unknown motion generator 'cosly'"):
        registry.check_unique(MOTIONS, "cosly")


class Hop:
    """A class of this process."""

    def __init__(self, *, height=0.1):
        self.height = height


@pytest.fixture
def registered(monkeypatch):
    monkeypatch.setattr(registry, "_REGISTERED", [])
    registry.register(MOTIONS, "hop", Hop)


def test_what_a_script_registers_is_found_like_the_rest(registered):
    assert "hop" in registry.names(MOTIONS)
    assert registry.build(MOTIONS, "hop", {"height": 0.3}).height == 0.3
    assert "unknown parameter 'hight'" in message(registry.build, MOTIONS, "hop", {"hight": 1})


def test_registering_again_replaces(registered):
    registry.register(MOTIONS, "hop", Hop)
    assert registry.names(MOTIONS).count("hop") == 1
    assert registry.load(MOTIONS, "hop") is Hop


def test_registering_takes_no_name_from_anyone(registered):
    assert "is installed already" in message(registry.register, MOTIONS, "linear", Hop)

    class Inner:
        pass

    assert "at the top of its module" in message(registry.register, MOTIONS, "inner", Inner)
    assert "unknown plugin group" in message(registry.register, "kinfeas.hops", "hop", Hop)
