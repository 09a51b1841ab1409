import json

import pytest

from kinfeas.robots.loading import load_robot
from tests.cli.conftest import is_one_line
from tests.sim2real.policy_cases import change, set_entry, write_run


@pytest.fixture
def run(tmp_path):
    """A training run of the PR2."""
    write_run(load_robot("pr2"), tmp_path / "run" / "checkpoints" / "best")
    return tmp_path / "run"


@pytest.fixture
def file(kinfeas, run, tmp_path):
    assert kinfeas("export", "run", "--out", "pr2.onnx").code == 0
    return tmp_path / "pr2.onnx"


def test_exports_and_checks(kinfeas, run, tmp_path):
    outcome = kinfeas("export", "run", "--out", "pr2.onnx", "--json", "out.json")
    assert outcome.code == 0, outcome.err
    for words in ("exported: pr2.onnx", "pr2, omnidirectional", "off the training policy", "0.2 m"):
        assert words in outcome.out
    exported = json.loads((tmp_path / "out.json").read_text())
    assert 0.0 <= exported.pop("parity") <= 1e-5
    outcome = kinfeas("export", "--check", "pr2.onnx", "--robot", "pr2", "--json", "check.json")
    assert outcome.code == 0, outcome.err
    for words in ("pr2.onnx: in order", "those of pr2 here", "90.0 % of 256", "r_wrist_roll_joint"):
        assert words in outcome.out
    checked = json.loads((tmp_path / "check.json").read_text())
    assert checked == exported
    assert checked["file"] == "pr2.onnx"
    assert checked["robot"]["name"] == "pr2"
    outcome = kinfeas("export", "--check", "pr2.onnx")
    assert outcome.code == 0
    assert "not compared" in outcome.out


def test_the_shipped_policy_of_a_robot(kinfeas):
    outcome = kinfeas("export", "pretrained", "--robot", "hsr", "--out", "hsr.onnx")
    assert outcome.code == 0, outcome.err
    assert "1.5 rad/s" in outcome.out


def test_evaluate_takes_the_file(kinfeas, file, tmp_path):
    for policy in ("run", "pr2.onnx"):
        arguments = (
            "--episodes",
            "2",
            "--set",
            "world.max_seconds=3.0",
            "--json",
            f"{policy}.json",
        )
        outcome = kinfeas("evaluate", "--policy", policy, *arguments)
        assert outcome.code == 0, outcome.err
    one, two = (json.loads((tmp_path / f"{name}.json").read_text()) for name in ("run", "pr2.onnx"))
    assert one["ik_failures_per_episode"] == two["ik_failures_per_episode"]


def test_evaluate_takes_the_robot_of_the_file(kinfeas):
    assert kinfeas("export", "pretrained", "--robot", "hsr", "--out", "hsr.onnx").code == 0
    short = ("--episodes", "1", "--set", "world.max_seconds=1")
    for name in ("hsr.onnx", "rollout_planner:hsr.onnx"):
        outcome = kinfeas("evaluate", "--policy", name, *short)
        assert outcome.code == 0, outcome.err
        assert f"{name} on ggr, robot hsr" in outcome.out
    outcome = kinfeas("evaluate", "--policy", "hsr.onnx", "--robot", "pr2", *short)
    assert is_one_line(outcome)
    assert "a policy for robot 'hsr', not for 'pr2'" in outcome.err


def test_a_spoiled_file_is_refused_in_one_line(kinfeas, file):
    file.write_bytes(file.read_bytes()[:-1000])
    for arguments in (("export", "--check"), ("evaluate", "--policy")):
        outcome = kinfeas(*arguments, "pr2.onnx")
        assert is_one_line(outcome)
        assert "pr2.onnx: truncated" in outcome.err


def test_words_of_a_file_do_nothing_to_the_terminal(kinfeas, file):
    change(file, lambda model: set_entry(model, "version", "[/bold][link=x]\x1b[2J\n"))
    outcome = kinfeas("export", "--check", "pr2.onnx")
    assert outcome.code == 0, outcome.err
    assert "kinfeas [/bold][link=x]?[2J?" in outcome.out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), "give a policy and --out FILE"),
        (("run",), "give a policy and --out FILE"),
        (("--out", "x.onnx"), "give a policy and --out FILE"),
        (("run", "--out", "x.onnx", "--check", "pr2.onnx"), "give a policy and --out FILE"),
        (("--check", "none.onnx"), "none.onnx: cannot be read"),
        (("--check", "empty.onnx"), "empty.onnx: empty, and so not the ONNX file of an export"),
        (("empty.onnx", "--out", "x.onnx"), "empty.onnx: not the folder of a training run"),
        (("follow_ee", "--out", "x.onnx"), "nothing else can be exported"),
        (("", "--out", "x.onnx"), "'': not the folder of a training run"),
        (("/dev/null", "--out", "x.onnx"), "nothing else can be exported"),
        (("nowhere", "--out", "x.onnx"), "nowhere: not the folder of a training run or of a"),
        ((".", "--out", "x.onnx"), ".: not a training run or checkpoint"),
        (("run", "--out", "none/x.onnx"), "none/x.onnx: cannot be written"),
        (("run", "--out", "run"), "run: is a folder"),
        (("run", "--out", ""), ".: is a folder"),
        (("run", "--out", "x.onnx", "--robot", "hsr"), "a policy for robot 'pr2'"),
        (("run", "--out", "x.onnx", "--robot", "pr3"), "unknown robot 'pr3'"),
        (("pretrained", "--out", "x.onnx", "--json", "none/x.json"), "cannot be written"),
    ],
)
def test_bad_input(kinfeas, run, tmp_path, arguments, words):
    (tmp_path / "empty.onnx").write_bytes(b"")
    outcome = kinfeas("export", *arguments)
    assert is_one_line(outcome), outcome.err
    assert words in outcome.err
    assert not (tmp_path / "x.onnx").exists()


def test_another_robot(kinfeas, file):
    outcome = kinfeas("export", "--check", "pr2.onnx", "--robot", "hsr")
    assert is_one_line(outcome)
    assert "a policy for robot 'pr2', not for 'hsr'" in outcome.err
