import json
import re

import numpy as np
import pytest
from typer.testing import CliRunner

from kinfeas.benchmark import speed as speed_module
from kinfeas.benchmark.speed import Figure, random_network
from kinfeas.cli.main import app
from kinfeas.cli.plugin_facts import fields_of
from kinfeas.config import strict_yaml
from kinfeas.config.recipes import default_recipe
from kinfeas.control.filters.rollout import RolloutConfig, RolloutPlanner
from kinfeas.core.errors import KinfeasError
from kinfeas.envs.world import WorldConfig
from kinfeas.evaluation import evaluate as evaluate_module
from kinfeas.policies.network import write_network
from kinfeas.robots.loading import load_robot
from kinfeas.sim2real.deploy.config import DeployConfig, Guards

SHORT = ["--set", "world.max_seconds=3.0", "--episodes", "3"]


def kinfeas(*arguments):
    """Run a command; an exception that `main` would report is raised."""
    result = CliRunner().invoke(app, list(arguments))
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


def test_evaluate(tmp_path):
    path = tmp_path / "out.json"
    result = kinfeas("evaluate", "--policy", "follow_ee", *SHORT, "--json", str(path))
    assert result.exit_code == 0
    assert "ceiling" in result.output
    figures = json.loads(path.read_text())
    assert figures["episodes"] == 3
    assert figures["policy"] == "follow_ee"
    assert 0.0 <= figures["ceiling"] <= 1.0


@pytest.mark.parametrize("world", ["analytic", "pybullet"])
def test_how_far_and_widely_to_look_ahead_can_be_set(tmp_path, monkeypatch, world):
    seen = []
    monkeypatch.setattr(RolloutPlanner, "watch", lambda self, loop: seen.append(self.rollout))
    monkeypatch.setattr(
        RolloutPlanner, "act", lambda self, policy_input: self.policy.act(policy_input)
    )
    if world == "pybullet":
        pytest.importorskip("pybullet")
    chosen = ["--set", "rollout.horizon=2", "--set", "rollout.num_samples=8"]
    short = ["--world", world, "--episodes", "1", "--set", "world.max_seconds=0.2"]
    for more in ([], chosen):
        kinfeas("evaluate", "--policy", "follow_ee", "--rollout-planner", *short, *more)
    assert seen == [RolloutConfig(), RolloutConfig(horizon=2.0, num_samples=8)]


def test_to_look_ahead_by_option_and_by_name_is_the_same(tmp_path):
    names = []
    for policy in (
        ["rollout_planner:follow_ee"],
        ["rollout_planner:follow_ee", "--rollout-planner"],
    ):
        path = tmp_path / "out.json"
        kinfeas("evaluate", "--policy", *policy, *SHORT, "--json", str(path))
        names.append(json.loads(path.read_text()))
    assert names[0] == names[1]
    assert names[0]["policy"] == "rollout_planner:follow_ee"


def test_a_ceiling_that_is_not_known_is_not_shown_as_zero(tmp_path, monkeypatch):
    monkeypatch.setattr(evaluate_module, "reachability_of", lambda *_: None)
    path = tmp_path / "out.json"
    result = kinfeas("evaluate", "--policy", "follow_ee", *SHORT, "--json", str(path))
    (row,) = (line for line in result.output.splitlines() if "ceiling" in line)
    assert "%" not in row
    assert " - " in row
    assert json.loads(path.read_text())["ceiling"] is None


def test_evaluate_a_trained_policy_on_another_robot_and_task(tmp_path):
    robot = load_robot("tiago")
    write_network(random_network(robot, width=8), tmp_path, robot, {})
    options = ["--robot", "tiago", "--task", "ggr_restricted", "--seed", "7"]
    result = kinfeas("evaluate", "--policy", str(tmp_path), *options, *SHORT)
    assert "ggr_restricted, robot tiago, 3 episodes of seed 7" in " ".join(result.output.split())


def test_evaluate_a_robot_by_its_path():
    path = str(load_robot("pr2").urdf_path.with_suffix(".yaml"))
    assert kinfeas("evaluate", "--policy", "follow_ee", "--robot", path, *SHORT).exit_code == 0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--policy", "follow_me"], "unknown policy"),
        (["--policy", "follow_ee", "--robot", "pr3"], "unknown robot"),
        (["--policy", "follow_ee", "--task", "gr"], "unknown task"),
        (["--policy", "follow_ee", "--set", "world.dt=0"], "world.dt"),
        (["--policy", "follow_ee", "--set", "word.dt=0.1"], "did you mean 'world'"),
        (["--policy", "follow_ee", "--set", "task.colour=1"], "colour"),
        (["--policy", "follow_ee", "--set", "rollout.num_samples=8"], "needs --rollout-planner$"),
        (
            ["--policy", "follow_ee", "--rollout-planner", "--set", "rollout.num_sample=8"],
            "did you mean 'num_samples'",
        ),
        (["--policy", "follow_ee", "--json", "missing/out.json"], "cannot be written"),
        (
            ["--policy", "follow_ee", "--world", "pybullet", "--head-start", "-1"],
            r"^--head-start: must be a number in \[0, 100000\], not -1.0",
        ),
        (
            ["--policy", "follow_ee", "--world", "pybullet", "--slow-down", "0"],
            r"^--slow-down: must be a number in \[1, 1000\], not 0.0",
        ),
        (["--policy", ""], "the name of the policy is empty"),
        (["--policy", "follow_ee", "--adapters", ""], "unknown configuration ''; known are"),
        (["--policy", "follow_ee", "--set", "world.adapters=[{name: nois}]"], "adapter 'nois'"),
    ],
)
def test_evaluate_refuses(arguments, message):
    with pytest.raises(KinfeasError, match=message):
        kinfeas("evaluate", *arguments)


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["--policy", "follow_ee", "--episodes", "0"],
        ["--policy", "follow_ee", "--episodes", "99999999999999999999"],
        ["--policy", "follow_ee", "--processes", "257"],
        ["--policy"],
    ],
)
def test_evaluate_is_used_wrongly(arguments):
    assert kinfeas("evaluate", *arguments).exit_code == 2


SETTINGS = {
    "evaluate": [WorldConfig(), RolloutConfig()],
    "deploy": [DeployConfig(), Guards(), RolloutConfig()],
}


@pytest.mark.parametrize("command", SETTINGS)
def test_help_tells_every_setting_with_its_default_and_its_unit(monkeypatch, command):
    monkeypatch.setenv("COLUMNS", "2000")
    shown = CliRunner().invoke(app, [command, "--help"]).output
    for one in (setting for settings in SETTINGS[command] for setting in fields_of(settings)):
        assert re.search(rf"\b{one.name}\b", shown), one
        if one.default == "null":
            assert f"{one.name} ({one.unit})" in shown, one
        elif re.fullmatch(r"\d[\d.]*|true|false", str(one.default)):
            assert f"{one.name}={one.default} {one.unit}".strip() in shown, one


@pytest.mark.parametrize(("command", "folder"), [("evaluate", "pybullet"), ("deploy", "deploy")])
def test_help_tells_the_settings_that_robots_have_of_their_own(monkeypatch, command, folder):
    monkeypatch.setenv("COLUMNS", "2000")
    shown = CliRunner().invoke(app, [command, "--help"]).output
    own = {name: strict_yaml.read(default_recipe(folder, name)) for name in ("pr2", "tiago", "hsr")}
    execution = {name: data.get("world", data) for name, data in own.items()}
    slow = [f"{keys['slow_down']:g} for {name}" for name, keys in execution.items()
            if keys.get("slow_down", 1.0) != 1.0]  # fmt: skip
    assert f"slow_down=1 ({', '.join(slow)})" in shown
    filtered = [name for name, keys in execution.items() if keys.get("feasibility_filter")]
    assert f"true for {' and '.join(filtered)}" in shown


def test_evaluate_with_physics(tmp_path):
    pytest.importorskip("pybullet")
    path = tmp_path / "out.json"
    options = ["--world", "pybullet", "--episodes", "1", "--robot", "hsr", "--task", "drawer"]
    options += ["--head-start", "0.2", "--slow-down", "1.5", "--no-objects"]
    short = ["--set", "world.max_seconds=0.5", "--json", str(path)]
    result = kinfeas("evaluate", "--policy", "follow_ee", *options, *short)
    assert "collisions of the base" in result.output
    figures = json.loads(path.read_text())
    assert (figures["head_start"], figures["slow_down"]) == (0.2, 1.5)
    assert figures["objects"] is False
    assert figures["task_success"] is None


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--head-start", "3"), "world.head_start=5"),
        (("--slow-down", "2"), "world.slow_down=2"),
        (("--no-objects",), "world.objects=true"),
    ],
)
def test_an_option_and_its_setting_exclude_each_other(options, said):
    short = ["--policy", "follow_ee", "--world", "pybullet", "--episodes", "1"]
    key = said.partition("=")[0]
    with pytest.raises(KinfeasError, match=f"^{options[0]} and --set {key} exclude each other$"):
        kinfeas("evaluate", *short, *options, "--set", said)


def test_a_window_needs_a_screen(monkeypatch):
    pytest.importorskip("pybullet")
    monkeypatch.delenv("DISPLAY", raising=False)
    with pytest.raises(KinfeasError, match="a window needs a screen"):
        kinfeas(
            "evaluate", "--policy", "follow_ee", "--world", "pybullet", "--gui", "--episodes", "1"
        )


@pytest.mark.parametrize(
    "option",
    [
        ["--head-start", "3"],
        ["--slow-down", "2"],
        ["--no-objects"],
        ["--gui"],
    ],
)
def test_the_analytic_world_has_no_such_options(option):
    with pytest.raises(KinfeasError, match=f"{option[0]} needs --world pybullet"):
        kinfeas("evaluate", "--policy", "follow_ee", *option)


TASK = """
name: fetch
places: {cup: {position: [1.5, [-1, 1], 0.8]}}
subgoals: [{place: cup, offset: [-0.2, 0, 0], frame: tip}, {place: cup, frame: tip, dwell: 1}]
"""


def test_a_task_of_ones_own(tmp_path):
    path = tmp_path / "fetch.yaml"
    path.write_text(TASK)
    result = kinfeas("evaluate", "--policy", "follow_ee", "--task", str(path), *SHORT)
    assert "follow_ee on fetch, robot pr2" in " ".join(result.output.split())
    changed = ["--task", str(path), "--set", "task.start.square=0", "--episodes", "4"]
    result = kinfeas("ceiling", *changed)
    assert "ceiling of fetch, robot pr2, 4 goals" in " ".join(result.output.split())
    path.write_text(TASK.replace("offset", "ofset"))
    with pytest.raises(KinfeasError, match="did you mean 'offset'"):
        kinfeas("evaluate", "--policy", "follow_ee", "--task", str(path), *SHORT)


def test_ceiling_along_the_way(tmp_path):
    path = tmp_path / "out.json"
    result = kinfeas("ceiling", "--episodes", "3", "--path", "--json", str(path))
    assert "the way there included" in " ".join(result.output.split())
    assert json.loads(path.read_text())["path"] is True


def test_ceiling(tmp_path):
    path = tmp_path / "out.json"
    result = kinfeas("ceiling", "--episodes", "8", "--seed", "3", "--json", str(path))
    assert result.exit_code == 0
    figures = json.loads(path.read_text())
    assert figures["convergence"][-1] == figures["ceiling"]
    assert figures["ceiling_low"] <= figures["ceiling"] <= figures["ceiling_high"]
    assert len(figures["convergence"]) == len(figures["base_poses"])


def test_ceiling_is_the_one_that_evaluate_shows(tmp_path):
    paths = tmp_path / "ceiling.json", tmp_path / "evaluate.json"
    settings = ["--set", "task.heights=[0.1,1.5]", "--seed", "3", "--json"]
    kinfeas("ceiling", "--episodes", "3", *settings, str(paths[0]))
    kinfeas("evaluate", "--policy", "follow_ee", *SHORT, *settings, str(paths[1]))
    first, second = (json.loads(path.read_text())["ceiling"] for path in paths)
    assert first == second


def test_speed(tmp_path, monkeypatch):
    figures = [Figure("one", 1.5, "us", "one_us"), Figure("peer", None, "us", "peer_us")]
    figures += [Figure("solved", 0.25, ""), Figure("rate", 12345.6, "steps/s")]
    monkeypatch.setattr(speed_module, "measure_speed", lambda *_, **__: figures)
    path = tmp_path / "out.json"
    result = kinfeas("speed", "--json", str(path))
    assert json.loads(path.read_text()) == {"one_us": 1.5, "peer_us": None}
    for text in ("1.50 us", "not installed", "25.0 %", "12,346 steps/s"):
        assert text in result.output


def test_speed_times_the_policy_of_a_run(tmp_path, monkeypatch):
    robot, timed = load_robot("pr2"), []
    network = random_network(robot, width=4)
    write_network(network, tmp_path, robot, {})
    monkeypatch.setattr(
        speed_module, "measure_speed", lambda robot, network, on_part: timed.append(network) or []
    )
    kinfeas("speed", "--policy", str(tmp_path))
    np.testing.assert_array_equal(timed[0].weights[0], network.weights[0])
    with pytest.raises(KinfeasError, match="trained policies only"):
        kinfeas("speed", "--policy", "follow_ee")


def test_plugins_list(tmp_path):
    path = tmp_path / "out.json"
    result = kinfeas("plugins", "list", "--json", str(path))
    assert result.exit_code == 0
    listed = {(entry["group"], entry["name"]) for entry in json.loads(path.read_text())}
    assert {("kinfeas.robots", "pr2"), ("kinfeas.motion_generators", "linear")} <= listed
    assert "motion generator" in result.output
