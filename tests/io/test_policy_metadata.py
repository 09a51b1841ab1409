import json
from pathlib import Path

import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.io.policy_metadata import (
    Trained,
    policy_folder,
    read_best,
    read_trained,
    write_trained,
)

FIGURES = {"episodes": 256, "success": 0.9, "success_low": 0.8, "success_high": 1.0}
TRAINED = Trained(
    robot="pr2",
    layers=3,
    kinematics="sha256:0",
    config={"robot": "my/pr2.yaml", "world": {"dt": 0.1}, "task_parameters": {"x": float("inf")}},
    steps=0,
    evaluation=FIGURES,
    seed=1,
    version="0.1.0",
    command="kinfeas train",
    benchmark={"door": {"success": 0.5}},
)
ROOT = Path(__file__).parents[2]


def write(folder, **changes):
    told = {"format": 1, "robot": "pr2", "layers": 3, **changes}
    (folder / "policy.json").write_text(json.dumps(told))
    return folder


@pytest.mark.parametrize("trained", [TRAINED, Trained(robot="hsr", layers=1)])
def test_what_is_written_is_read_back(tmp_path, trained):
    write_trained(trained, tmp_path)
    assert read_trained(tmp_path) == trained


def test_what_is_not_known_is_left_out(tmp_path):
    write_trained(Trained(robot="hsr", layers=1, steps=0), tmp_path)
    told = json.loads((tmp_path / "policy.json").read_text())
    assert told == {"format": 1, "robot": "hsr", "layers": 1, "steps": 0}


def test_a_run_is_known_by_its_best_checkpoint(tmp_path):
    best = tmp_path / "checkpoints" / "best"
    best.mkdir(parents=True)
    write_trained(TRAINED, best)
    assert policy_folder(tmp_path) == best
    assert read_trained(tmp_path) == read_best(tmp_path) == TRAINED


@pytest.mark.parametrize(
    ("config", "robot", "period"),
    [
        ({}, "pr2", None),
        ({"robot": "my/pr2.yaml", "world": {"dt": 0.02}}, "my/pr2.yaml", 0.02),
        ({"robot": 5, "world": {"dt": float("inf")}}, "5", None),
        ({"world": {"dt": float("nan")}}, "pr2", None),
        ({"world": {"dt": "0.1"}}, "pr2", None),
        ({"world": [0.1]}, "pr2", None),
    ],
)
def test_the_settings_may_hold_anything(tmp_path, config, robot, period):
    trained = read_trained(write(tmp_path, config=config))
    assert (trained.trained_with, trained.period) == (robot, period)


def test_what_else_a_file_tells_does_no_harm(tmp_path):
    assert read_trained(write(tmp_path, notes="mine")) == Trained(robot="pr2", layers=3)


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("layers", float("inf"), "'layers'"),
        ("layers", float("nan"), "'layers'"),
        ("layers", 3.0, "'layers'"),
        ("layers", "3", "'layers'"),
        ("layers", 0, "'layers'"),
        ("format", 99, "'format'"),
        ("format", None, "'format'"),
        ("robot", ["pr2"], r"'robot'"),
        ("kinematics", 5, "'kinematics'"),
        ("config", 5, "'config'"),
        ("evaluation", {"success": float("nan")}, "'evaluation.success' must be .*, not nan"),
        ("evaluation", {"episodes": 10**400}, "'evaluation.episodes' must be .*, not 1000"),
    ],
)
def test_a_broken_entry_is_one_sentence(tmp_path, key, value, message):
    with pytest.raises(KinfeasError, match=rf"^{tmp_path}/policy\.json: {message}"):
        read_trained(write(tmp_path, **{key: value}))


@pytest.mark.parametrize("text", ["[" * 200_000, '{"robot": ' * 100_000, "3", "[]", "{}", "null"])
def test_a_foreign_file_is_one_sentence(tmp_path, text):
    (tmp_path / "policy.json").write_text(text)
    with pytest.raises(KinfeasError, match=rf"^{tmp_path}/policy\.json: ") as caught:
        read_trained(tmp_path)
    assert "\n" not in str(caught.value)


def test_no_file_is_one_sentence(tmp_path):
    with pytest.raises(KinfeasError, match=f"^{tmp_path}: not a training run or checkpoint: there"):
        read_trained(tmp_path)


@pytest.mark.parametrize("missing", ["evaluation", "steps"])
def test_a_best_checkpoint_was_judged(tmp_path, missing):
    told = {"steps": 9, "evaluation": FIGURES}
    del told[missing]
    with pytest.raises(KinfeasError, match=f"^{tmp_path}: not the best checkpoint of a training r"):
        read_best(write(tmp_path, **told))


@pytest.mark.parametrize("name", ["pr2", "tiago", "hsr"])
def test_a_shipped_file_is_written_as_it_is(tmp_path, name):
    shipped = ROOT / "kinfeas" / "policies" / "pretrained" / name
    write_trained(read_trained(shipped), tmp_path)
    assert (tmp_path / "policy.json").read_bytes() == (shipped / "policy.json").read_bytes()
