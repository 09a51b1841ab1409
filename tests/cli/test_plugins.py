import sys
from pathlib import Path

import pytest

from kinfeas.config.registry import GROUPS
from tests.cli.conftest import check_one_line


@pytest.fixture
def info(kinfeas):
    """Return a function that returns the JSON of `kinfeas plugins info NAME`."""

    def run(name):
        outcome = kinfeas("plugins", "info", name, "--json", "out.json")
        assert (outcome.code, outcome.err) == (0, "")
        assert f" {Path(name).stem}, from " in outcome.out
        return outcome.facts[0]

    return run


def test_list_has_every_group(kinfeas):
    outcome = kinfeas("plugins", "list", "--json", "out.json", code=0)
    assert {plugin["group"] for plugin in outcome.facts} == set(GROUPS)
    own = [plugin for plugin in outcome.facts if plugin["distribution"] == "kinfeas"]
    assert all(plugin["description"] and plugin["error"] is None for plugin in own)
    assert all(kind[:-1] in outcome.out for kind in GROUPS.values())


@pytest.mark.filterwarnings("ignore:.*is ignored:UserWarning")
def test_list_shows_broken_plugins(kinfeas, tmp_path, monkeypatch):
    (tmp_path / "odd.py").write_text("def robot():\n    raise RuntimeError('no file')\n")
    installed = tmp_path / "odd-1.0.dist-info"
    installed.mkdir()
    (installed / "METADATA").write_text("Name: odd\nVersion: 1.0\n")
    entries = "[kinfeas.robots]\nodd = odd:robot\n[kinfeas.filters]\nfeasibility = odd:robot\n"
    entries += "[kinfeas.tasks]\nno_class = odd:__name__\n"
    (installed / "entry_points.txt").write_text(entries)
    monkeypatch.syspath_prepend(tmp_path)
    facts = kinfeas("plugins", "list", "--json", "out.json", code=0).facts
    errors = {each["name"]: each["error"] for each in facts if each["distribution"] == "odd"}
    assert errors.keys() == {"odd", "feasibility", "no_class"}
    assert "class or function" in errors["no_class"]
    check_one_line(kinfeas("plugins", "info", "no_class"), "class or function")
    assert "RuntimeError: no file" in errors["odd"]
    assert "kinfeas has one" in errors["feasibility"]


def test_info_on_parameters(info):
    facts = info("linear")
    assert {"name": "gain", "type": "float", "default": 0.1} in facts["parameters"]
    assert "gain: Speed per distance" in facts["text"]
    required = {entry["name"]: entry for entry in info("waypoints")["parameters"]}["file"]
    assert "default" not in required
    distance = {"name": "distance", "type": "tuple[float, float]", "default": [1, 5]}
    assert distance in info("ggr")["parameters"]
    assert len(info("hsr")["robot"]["arm"]) == 5


def test_info_on_files_and_unknown_names(kinfeas, tmp_path):
    task = tmp_path / "mine.yaml"
    task.write_text("name: mine\nplaces: {up: {position: [1, 0, 1]}}\nsubgoals: [{place: up}]\n")
    outcome = kinfeas("plugins", "info", str(task), "--json", "out.json", code=0)
    assert [subgoal["place"] for subgoal in outcome.facts[0]["subgoals"]] == ["up"]
    task.write_text(task.read_text().replace("place: up", "place: down"))
    check_one_line(kinfeas("plugins", "info", str(task)), "'down'")
    outcome = kinfeas("plugins", "info", "linaer")
    check_one_line(outcome, "linear")
    assert "pip install" in outcome.err
    assert "pick_place" not in outcome.err


@pytest.mark.parametrize(("words", "wrong", "named"), [
    (("follow_ee", "--robot", "hsr"), ("follow_ee", "--robot", "hsr", "--set", "gain=1"),
     "follow_ee"),
    (("actuator_lag", "--set", "base=0.2"), ("actuator_lag", "--set", "base=-1"), "base"),
    (("time_scaling", "--robot", "hsr"), ("time_scaling", "--picture", "scaling.png"), "picture"),
    (("analytic", "--robot", "hsr"), ("ros2", "--robot", "hsr"), "simulators"),
])  # fmt: skip
def test_check_of_plugins_on_a_robot(kinfeas, words, wrong, named):
    check = ("plugins", "check")
    assert kinfeas(*check, *words, "--json", "out.json", code=0).facts["passed"] is True
    check_one_line(kinfeas(*check, *wrong), named)


@pytest.mark.parametrize(("name", "named"), [
    ("follow_ee", "--robot"), ("door", "is a task"), ("time_scalin", "'time_scaling'"),
])  # fmt: skip
def test_check_names_what_it_needs_or_does_not_cover(kinfeas, name, named):
    check_one_line(kinfeas("plugins", "check", name), named)


def test_options_name_generators_of_the_working_directory(kinfeas, tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "path", [*sys.path])
    source = "from kinfeas.plugins.linear import Linear\nclass Arc(Linear): pass\n"
    (tmp_path / "my_motion.py").write_text(source)
    kinfeas("plugins", "check", "my_motion:Arc", "--duration", "60", code=0)
    words = ("evaluate", "--policy", "follow_ee", "--robot", "hsr", "--episodes", "1")
    words += ("--set", "world.max_seconds=1", "--set", "task.motion={generator: 'my_motion:Arc'}")
    kinfeas(*words, code=0)


def test_check_of_a_generator_that_breaks_rules(kinfeas):
    settings = ["--set", "max_velocity=0.4", "--set", "max_angular_velocity=null"]
    words = [*settings, "--duration", "9", "--json", "out.json"]
    outcome = kinfeas("plugins", "check", "linear", *words)
    check_one_line(outcome)
    assert outcome.facts["passed"] is False
    broken = {rule["rule"] for rule in outcome.facts["rules"] if rule["broken"]}
    assert {"angular_velocity", "arrival"} <= broken
