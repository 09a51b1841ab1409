import json
from dataclasses import replace

import pytest

from kinfeas.config import to_mapping
from kinfeas.core.errors import KinfeasError
from kinfeas.core.policy import TermInfo
from kinfeas.io.policy_metadata import Trained, read_best, read_trained, write_trained

FIGURES = {"episodes": 256, "success": 0.9, "success_low": 0.8, "success_high": 1.0}
TERMS = {
    "observation": (TermInfo("goal_position", 3, "base_footprint", "m"),),
    "action": (TermInfo("base", 2, "base_footprint", "m/s", ("x", "y"), (0.2, 0.2)),),
}
BARE = Trained(robot="pr2", layers=3, **TERMS)
CONFIG = {"robot": "my/pr2.yaml", "world": {"dt": 0.1}, "task_parameters": {"x": float("inf")}}
TRAINED = replace(
    BARE, kinematics="sha256:0", config=CONFIG, steps=0, evaluation=FIGURES, seed=1,
    version="0.1.0", command="kinfeas train",
)  # fmt: skip


def write(folder, **changes):
    data = {**to_mapping(BARE), "notes": "ignored", **changes}
    (folder / "policy.json").write_text(json.dumps(data))
    return folder


@pytest.mark.parametrize("trained", [TRAINED, BARE])
def test_round_trip(tmp_path, trained):
    write_trained(trained, tmp_path)
    assert read_trained(tmp_path) == trained


@pytest.mark.parametrize(("dt", "period"), [(None, None), (0.02, 0.02), (float("inf"), None)])
def test_period_of_the_configuration(tmp_path, dt, period):
    assert read_trained(write(tmp_path, config={"world": {"dt": dt}})).period == period


@pytest.mark.parametrize(
    ("key", "value"),
    [("layers", 0), ("format", 99), ("config", 5), ("evaluation", {"success": float("nan")})],
)
def test_invalid_entries_are_named(tmp_path, key, value):
    with pytest.raises(KinfeasError, match=f"^{tmp_path}: "):
        read_trained(tmp_path)
    with pytest.raises(KinfeasError, match=rf"^{tmp_path}/policy\.json.*{key}"):
        read_trained(write(tmp_path, **{key: value}))


@pytest.mark.parametrize("missing", ["evaluation", "steps"])
def test_the_best_checkpoint_has_an_evaluation(tmp_path, missing):
    entries = {"steps": 9, "evaluation": FIGURES}
    del entries[missing]
    with pytest.raises(KinfeasError, match=f"^{tmp_path}: "):
        read_best(write(tmp_path, **entries))
