import json
import re
from pathlib import Path

import pytest

from kinfeas.core.registry import GROUPS, load
from kinfeas.testing import RULES
from tests.cli.conftest import is_one_line


def test_list_shows_every_group_and_where_each_comes_from(kinfeas, tmp_path):
    outcome = kinfeas("plugins", "list", "--json", "plugins.json")
    assert outcome.code == 0
    found = json.loads((tmp_path / "plugins.json").read_text())
    assert {one["group"] for one in found} == set(GROUPS)
    own = [one for one in found if one["distribution"] == "kinfeas"]
    assert all(one["description"] and one["error"] is None for one in own)
    described = {one["name"]: one["description"] for one in own}
    assert described["pr2"] == "omnidirectional base, arm of 7 joints"


def test_list_has_a_table_for_each_kind(kinfeas, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    shown = kinfeas("plugins", "list").out
    titles = [line.split(",")[0] for line in shown.splitlines() if line[0] not in "┏┃┡│└"]
    assert titles == [f"{kind}s" for kind in GROUPS.values()]
    assert shown.count("kinfeas 0") == len(GROUPS)
    assert len(shown.splitlines()) < 90


def test_list_says_where_each_plugin_of_a_kind_comes_from_if_it_is_not_one_place(
    kinfeas, broken, monkeypatch
):
    broken("odd")
    monkeypatch.setenv("COLUMNS", "80")
    motions, robots = kinfeas("plugins", "list").out.split("robots, from kinfeas")
    assert motions.startswith("motion generators ")
    assert "│ odd              │ kinfeas-odd 1 " in motions
    assert "kinfeas" not in robots.partition("tasks, from")[0].partition("\n")[2]


def test_info_on_a_motion_generator(kinfeas, tmp_path):
    outcome = kinfeas("plugins", "info", "linear", "--json", "linear.json")
    assert "motion generator linear, from kinfeas" in outcome.out
    (known,) = json.loads((tmp_path / "linear.json").read_text())
    gain = {one["name"]: one for one in known["parameters"]}["gain"]
    assert (gain["type"], gain["unit"], gain["default"]) == ("float", "1/s", "0.1")
    assert gain["description"].startswith("Speed per distance to the goal")


def test_info_tells_the_unit_of_every_number_that_has_one(kinfeas, tmp_path):
    kinfeas("plugins", "list", "--json", "list.json")
    listed = json.loads((tmp_path / "list.json").read_text())
    told = {}
    for name in {one["name"] for one in listed if one["kind"] != "robot"}:
        kinfeas("plugins", "info", name, "--json", "info.json")
        for known in json.loads((tmp_path / "info.json").read_text()):
            told |= {f"{name}.{one['name']}": one for one in known.get("parameters", [])
                     if "float" in one["type"]}  # fmt: skip
    for name, one in told.items():
        assert one["unit"] or re.search("[Ss]hare|0-1|times", one["description"]), name
    units = {"head_start.seconds": "s", "ros1.seconds": "s", "ros2.seconds": "s",
             "acceleration_limit.linear_jerk": "m/s^3", "localisation.drift": "m",
             "acceleration_limit.angular_jerk": "rad/s^3", "localisation.rate": "1/s"}  # fmt: skip
    assert {name: told[name]["unit"] for name in units} == units


@pytest.mark.parametrize("name", ["ggr", "door", "base_noise", "analytic", "pybullet"])
def test_info_on_all_kinds(kinfeas, name):
    outcome = kinfeas("plugins", "info", name)
    assert (outcome.code, outcome.err) == (0, "")
    assert f" {name}, from kinfeas" in outcome.out
    assert "Annotated" not in outcome.out


def test_info_on_a_task_heads_its_grip_as_a_file_does(kinfeas):
    shown = kinfeas("plugins", "info", "door").out
    assert "close" in shown
    assert "grip " in shown
    assert "gripper" not in shown.partition("subgoals")[2]


def test_info_tells_lists_as_they_are_set(kinfeas, tmp_path):
    kinfeas("plugins", "info", "ggr", "--json", "ggr.json")
    [known] = json.loads((tmp_path / "ggr.json").read_text())
    defaults = {one["name"]: one["default"] for one in known["parameters"]}
    assert defaults["distance"] == "[1, 5]"


def test_info_on_a_robot(kinfeas, tmp_path):
    outcome = kinfeas("plugins", "info", "hsr", "--json", "hsr.json")
    assert "arm_lift_joint" in outcome.out
    (known,) = json.loads((tmp_path / "hsr.json").read_text())
    assert [joint["unit"] for joint in known["robot"]["arm"]] == ["m", "rad", "rad", "rad", "rad"]
    assert known["robot"]["base"]["drive"] == "omnidirectional"


def test_info_on_a_continuous_joint_has_no_limits(kinfeas, tmp_path):
    kinfeas("plugins", "info", "pr2", "--json", "pr2.json")
    (known,) = json.loads((tmp_path / "pr2.json").read_text())
    assert {joint["name"]: joint["lower"] for joint in known["robot"]["arm"]}[
        "r_forearm_roll_joint"
    ] is None


def test_info_on_files(kinfeas, tmp_path):
    robot = Path(load("kinfeas.robots", "hsr")())
    outcome = kinfeas("plugins", "info", str(robot), "--json", "hsr.json")
    assert (outcome.code, outcome.err) == (0, "")
    assert f"robot hsr, from {robot}\n" in outcome.out
    assert "arm_lift_joint" in outcome.out
    (known,) = json.loads((tmp_path / "hsr.json").read_text())
    assert (known["kind"], known["robot"]["name"]) == ("robot", "hsr")
    (tmp_path / "fetch.yaml").write_text(
        "{name: fetch, places: {here: {position: [1, 0, 1]}}, subgoals: [{place: here}]}"
    )
    outcome = kinfeas("plugins", "info", "fetch.yaml")
    assert "task fetch, from fetch.yaml\n" in outcome.out
    assert "linear" in outcome.out.partition("subgoals")[2]
    (tmp_path / "other.yaml").write_text("{adapters: []}")
    outcome = kinfeas("plugins", "info", "other.yaml")
    assert is_one_line(outcome)
    assert "other.yaml: describes no robot, which has the key 'urdf', and no task" in outcome.err
    outcome = kinfeas("plugins", "info", "./fetch.urdf")
    assert is_one_line(outcome)
    assert (
        "fetch.urdf: a robot is a YAML file, which kinfeas robot import fetch.urdf" in outcome.err
    )


def test_check_lists_every_rule_and_draws(kinfeas, tmp_path):
    outcome = kinfeas("plugins", "check", "linear", "--picture", "a.png", "--json", "a.json")
    assert outcome.code == 0
    assert "\na.png\nmotion generator linear passes" in outcome.out
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    found = json.loads((tmp_path / "a.json").read_text())
    assert found["passed"] is True
    assert [one["rule"] for one in found["rules"]] == list(RULES)


def test_check_tells_all_that_is_broken(kinfeas, tmp_path):
    settings = ["--set", "max_velocity=0.4", "--set", "max_angular_velocity=null"]
    outcome = kinfeas(
        "plugins", "check", "linear", *settings, "--duration", "9", "--json", "a.json"
    )
    assert outcome.code == 2
    assert "of 11 rules broken: motion generator linear moves at" in outcome.err
    found = json.loads((tmp_path / "a.json").read_text())
    broken = {one["rule"] for one in found["rules"] if one["result"] == "broken"}
    assert {"angular_velocity", "arrival"} <= broken
    assert "not checked" not in {one["result"] for one in found["rules"]}


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["info", "lienar"], "there is no plugin 'lienar' (did you mean 'linear'?)"),
        (["check", "pr2"], "unknown motion generator 'pr2'"),
        (["check", "linear", "--set", "gian=1"], "unknown parameter 'gian'"),
        (["check", "linear", "--set", "gain"], "error: --set gain: must be of the form key=value"),
        (["check", "waypoints", "--set", "file=3"], "'file' must be a string, not 3"),
        (["check", "linear", "--json", "."], ".: is a folder, not the path of a file"),
        (["check", "linear", "--picture", "no/a.png"], "cannot be written"),
        (["new", "linear"], "the name is taken by motion generator 'linear'"),
        (["new", "My"], "cannot be a name"),
        (["new", "mine", "--kind", "policy"], "policy"),
    ],
)
def test_bad_input_is_one_line(kinfeas, arguments, sentence):
    outcome = kinfeas("plugins", *arguments)
    assert outcome.code == 2
    assert outcome.err.startswith("error: ")
    assert outcome.err.count("\n") == 1
    assert sentence in outcome.err


BROKEN = {
    "leaves": "import sys\nsys.exit(7)\n",
    "number": "target = 3\n",
}
SENTENCES = {
    "leaves": "cannot be loaded: SystemExit: 7",
    "number": "must be a class or function, not int",
}


@pytest.fixture
def broken(offer, tmp_path):
    """The name of each broken plugin, which is installed."""

    def make(name):
        folder = tmp_path / name
        (folder / f"kinfeas_{name}").mkdir(parents=True)
        (folder / f"kinfeas_{name}" / "__init__.py").write_text(BROKEN[name])
        entries = f'[project.entry-points."kinfeas.motion_generators"]\n{name} = '
        project = f'[project]\nname = "kinfeas-{name}"\nversion = "1"\n'
        (folder / "pyproject.toml").write_text(f'{project}{entries}"kinfeas_{name}:target"\n')
        offer(folder)
        return name

    return make


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_plugin_disturbs_no_other(kinfeas, broken, tmp_path, name):
    broken(name)
    outcome = kinfeas("plugins", "list", "--json", "plugins.json")
    assert outcome.code == 0
    found = {one["name"]: one for one in json.loads((tmp_path / "plugins.json").read_text())}
    assert found["linear"]["error"] is None
    if name != "odd":  # which can be used
        assert SENTENCES[name] in found[name]["error"]


@pytest.mark.parametrize("name", BROKEN)
def test_info_on_a_broken_plugin_is_one_line(kinfeas, broken, name):
    outcome = kinfeas("plugins", "info", broken(name))
    assert outcome.code == 2
    assert SENTENCES[name] in outcome.err
    assert outcome.err.count("\n") == 1


def test_new_writes_a_distribution_here(kinfeas, tmp_path):
    outcome = kinfeas("plugins", "new", "my_motion")
    assert "pytest kinfeas-my-motion" in outcome.out
    assert (tmp_path / "kinfeas-my-motion" / "pyproject.toml").is_file()


def test_new_quotes_what_is_to_be_typed(kinfeas):
    outcome = kinfeas("plugins", "new", "my_motion", "--out", "my motions")
    assert "pip install -e 'my motions'\ntest it: pytest 'my motions'\n" in outcome.out


def test_a_missing_parameter_is_asked_for_by_its_set_line(kinfeas):
    outcome = kinfeas("plugins", "check", "replay")
    assert outcome.code == 2
    assert outcome.err.endswith("--set file=VALUE\n")
