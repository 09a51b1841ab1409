import json
import os
import random
import signal
import subprocess
import sys

import pytest

from kinfeas import config
from kinfeas.benchmark import evaluations
from kinfeas.config.recipes import default_engine
from kinfeas.training.config import TrainConfig
from tests.builders import TRAINING
from tests.cli.conftest import STUDY, check_one_line

PHYSICS = f"""
robots: [hsr]
tasks: [ggr]
policies: pretrained
baselines: {{"kinfeas.policies.baselines.following:follow_ee": [ggr]}}
backend: {default_engine()}
rows: [{{label: late, settings: {{world.head_start: 0.1}}}}]
settings: {{world.max_seconds: 0.3}}
"""


@pytest.fixture
def run(kinfeas, tmp_path):
    """Return a function that runs `kinfeas benchmark` with a small study."""
    (tmp_path / "study.yaml").write_text(STUDY)
    (tmp_path / "physics.yaml").write_text(PHYSICS)

    def benchmark(*arguments, **checks):
        config = () if "--config" in arguments else ("--config", "study.yaml")
        words = ("--out", "out", "--processes", "1", *config, *arguments)
        return kinfeas("benchmark", *words, **checks)

    return benchmark


@pytest.mark.slow
def test_study_is_trained_evaluated_published_and_not_repeated(run, tmp_path, monkeypatch):
    outcome = run("--json", "out.json", code=0)
    out = tmp_path / "out"
    for name in ("table.md", "table.json", "table.png", "learning_curves.png"):
        assert (out / name).is_file()
        assert f"out/{name}" in outcome.out
    assert "A very small one." in outcome.out
    assert outcome.facts == json.loads((out / "table.json").read_text())
    seeds = [(entry["policy"], entry["seeds"]) for entry in outcome.facts]
    assert seeds == [("sac", 2), ("follow_ee", 1)]
    assert sorted(path.name for path in (out / "runs").iterdir()) == ["hsr-0", "hsr-1"]
    about = json.loads((out / "pretrained" / "hsr" / "policy.json").read_text())
    assert about["config"]["robot"] == "hsr"

    monkeypatch.setattr(evaluations, "compute", None)
    before = (out / "table.json").read_bytes()
    for more in ((), ("--runs", "out/runs")):
        run(*more, code=0)
        assert (out / "table.json").read_bytes() == before


def test_physics_beside_the_analytic_world(run):
    engine = default_engine()
    words = ("--config", "physics.yaml", "--world", f" {engine}", "--episodes", "1")
    outcome = run(*words, "--json", "out.json", code=0)
    entries = outcome.facts
    assert "path_planner, feasibility: learned, pretrained" in outcome.out
    rows = [(entry["policy"], entry["row"]) for entry in entries]
    assert rows[:2] == [("pretrained", ""), ("pretrained", "late")]
    assert rows[2][0].endswith(":follow_ee")
    assert {entry["world"] for entry in entries} == {engine}
    assert None not in [entry["analytic_success"] for entry in entries]
    for setting, named in (("tasks=[door]", "hsr on ggr"), ("seeds=[1]", "seeds")):
        check_one_line(run(*words, "--set", setting), named)


SWEEP = f"""
robot: hsr
settings: {json.dumps(TRAINING | {"schedule.steps": 64, "schedule.minutes": None})}
space:
  learner.learning_rate: {{low: 1.0e-4, high: 1.0e-3, log: true}}
  learner.batch_size: {{choices: [16, 32]}}
trials: 3
"""


@pytest.mark.slow
def test_the_winner_is_a_recipe_that_train_takes(kinfeas, tmp_path):
    pytest.importorskip("optuna")
    (tmp_path / "mine.yaml").write_text(SWEEP)
    words = ("sweep", "mine.yaml", "--out", "my out", "--processes", "1")
    outcome = kinfeas(*words, "--json", "out.json", code=0)
    assert (tmp_path / "my out" / "sweep.png").read_bytes().startswith(b"\x89PNG")
    trials = outcome.facts
    assert [trial["number"] for trial in trials] == [0, 1, 2]
    assert "--config 'my out/best.yaml'" in outcome.out
    kinfeas("train", "--config", "my out/best.yaml", "--seed", "1", "--out", "again", code=0)
    assert config.load(TrainConfig, tmp_path / "again" / "config.yaml").seed == 1
    more = kinfeas(*words, "--set", "trials=4", "--json", "out.json", code=0)
    assert more.facts[:3] == trials
    check_one_line(kinfeas(*words, "--set", "seed=4"), "my out")
    check_one_line(kinfeas("sweep", "none"), "none")


KILLS = int(os.environ.get("KINFEAS_TEST_KILLS", "3"))
CASES = {
    "benchmark": (("benchmark", "--config", "case.yaml"), STUDY, "table.json"),
    "sweep": (("sweep", "case.yaml", "--set", "sampler=random", "--set", "pruner=none"),
              SWEEP.replace("trials: 3", "trials: 8"), "sweep.json"),
}  # fmt: skip


def start(case, folder):
    words, text, _ = CASES[case]
    (folder / "case.yaml").write_text(text)
    command = [sys.executable, "-m", "kinfeas", *words, "--out", "out", "--processes", "2"]
    with (folder / "log").open("a") as log:
        return subprocess.Popen(command, cwd=folder, stdout=log, stderr=log)


def finish(case, folder):
    assert start(case, folder).wait(timeout=900) == 0, (folder / "log").read_text()[-3000:]
    return (folder / "out" / CASES[case][2]).read_bytes()


def results(folder):
    paths = [*folder.glob("out/results/*.json"), *folder.glob("out/runs/*/evaluation.json")]
    return {path: (path.read_bytes(), path.stat().st_mtime_ns) for path in paths}


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_kills_change_nothing(tmp_path, case):
    """The command is killed at random moments; results of finished jobs stay as they are."""
    pytest.importorskip("optuna")
    rng, before = random.Random(case), {}
    killed, whole = tmp_path / "killed", tmp_path / "whole"
    for folder in (killed, whole):
        folder.mkdir()
    for _ in range(KILLS):
        process = start(case, killed)
        try:
            process.wait(timeout=rng.uniform(4.0, 15.0))
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGKILL)
            process.wait()
        assert results(killed).items() >= before.items()
        before = results(killed)
    assert finish(case, killed) == finish(case, whole)
    assert results(killed).items() >= before.items()
