import re
import subprocess
import sys

import pytest

from kinfeas.cli.policy_robot import DEFAULT, check_policy, robot_of
from kinfeas.core.errors import KinfeasError
from kinfeas.robots.loading import load_robot
from tests.cli.conftest import is_one_line
from tests.sim2real.policy_cases import write_policy_file, write_run


@pytest.mark.parametrize(
    "policy",
    [None, "", "pretrained", "follow_ee", "rollout_planner:pretrained", "nowhere", "no.onnx"],
)
def test_what_can_drive_any_robot_or_is_not_there_drives_the_default(policy):
    assert robot_of(policy) == DEFAULT


@pytest.mark.parametrize("policy", ["pretrained", "follow_ee", "rollout_planner:follow_ee", "."])
def test_a_policy_that_is_there(policy):
    check_policy(policy)


@pytest.mark.parametrize(
    ("policy", "message"),
    [
        ("nowhere", "unknown policy 'nowhere'; known are"),
        ("rollout_planner:folow_ee", "unknown policy 'folow_ee' (did you mean 'follow_ee'?)"),
        ("rollout_planner:", "the name of the policy is empty"),
    ],
)
def test_a_policy_that_is_not_there(policy, message):
    with pytest.raises(KinfeasError, match=re.escape(message)):
        check_policy(policy)


@pytest.mark.parametrize("line", ["evaluate --policy nowhere", "export nowhere --out x.onnx"])
def test_a_policy_that_is_not_there_is_refused_before_anything_slow_is_imported(tmp_path, line):
    code = """
import sys
from kinfeas.cli.main import main
try:
    main()
finally:
    print({"numba", "scipy", "onnx", "torch"} & set(sys.modules))
"""
    command = [sys.executable, "-c", code, *line.split()]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert (done.returncode, done.stdout) == (2, "set()\n")
    assert "nowhere" in done.stderr


@pytest.mark.parametrize("extra", [{}, {"config": {"robot": "hsr"}}])
def test_a_run_and_its_file_name_their_robot(tmp_path, extra):
    write_run(load_robot("hsr"), tmp_path / "run" / "checkpoints" / "best", extra=extra)
    assert robot_of(str(tmp_path / "run")) == "hsr"
    assert robot_of(f"rollout_planner:{tmp_path / 'run'}") == "hsr"


def test_a_file_names_the_robot_of_its_training(tmp_path):
    _, path = write_policy_file(load_robot("pr2"), tmp_path)
    assert robot_of(str(path)) == "pr2"


def test_a_robot_by_path_must_be_there(tmp_path):
    yaml = tmp_path / "mine.yaml"
    extra = {"config": {"robot": str(yaml)}}
    write_run(load_robot("hsr"), tmp_path / "run", extra=extra)
    with pytest.raises(KinfeasError, match=f"of {yaml}, which is not there: .* with --robot$"):
        robot_of(str(tmp_path / "run"))
    yaml.touch()
    assert robot_of(str(tmp_path / "run")) == str(yaml)


@pytest.mark.parametrize("line", ["evaluate --policy run", "deploy run --goal 1 0 1"])
def test_the_yaml_of_its_robot_is_not_written_over(kinfeas, tmp_path, line):
    yaml = tmp_path / "mine.yaml"
    yaml.touch()
    write_run(load_robot("hsr"), tmp_path / "run", extra={"config": {"robot": str(yaml)}})
    outcome = kinfeas(*line.split(), "--json", "mine.yaml")
    assert is_one_line(outcome)
    assert "must differ, but both name mine.yaml" in outcome.err


@pytest.mark.parametrize(
    ("content", "match"), [(b"", "empty, and so not"), (b"\x08\x07", "not written by")]
)
def test_a_file_that_is_no_policy(tmp_path, content, match):
    (tmp_path / "a.onnx").write_bytes(content)
    with pytest.raises(KinfeasError, match=match):
        robot_of(str(tmp_path / "a.onnx"))


def test_a_folder_that_is_no_run(tmp_path):
    with pytest.raises(KinfeasError, match="not a training run or checkpoint"):
        robot_of(str(tmp_path))


def test_needs_neither_torch_nor_onnx(tmp_path):
    _, path = write_policy_file(load_robot("pr2"), tmp_path)
    code = f"""
import sys
from kinfeas.cli.policy_robot import robot_of
robot_of({str(path)!r})
print({{"torch", "onnx"}} & set(sys.modules))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "set()\n"
