import json

import pytest

from kinfeas.benchmark import jobs
from kinfeas.core.errors import KinfeasError
from kinfeas.policies import pretrained
from tests.cli.conftest import TINY, is_one_line

STUDY = f"""
note: A very small one.
robots: [pr2]
tasks: [ggr]
baselines: {{follow_ee: [ggr]}}
trainings:
  - {{robot: pr2, steps: 64, settings: {json.dumps(list(TINY[1::2]))}}}
seeds: [0, 1]
episodes: 2
settings: ["world.max_seconds=2.5"]
"""


@pytest.fixture
def study(tmp_path):
    (tmp_path / "study.yaml").write_text(STUDY)
    return "study.yaml"


def run(kinfeas, *arguments):
    return kinfeas("benchmark", "--out", "out", "--processes", "1", *arguments)


def test_a_study_is_trained_judged_and_published(kinfeas, study, tmp_path, monkeypatch):
    outcome = run(kinfeas, "--config", study, "--publish", "ship", "--json", "out.json")
    assert outcome.code == 0, outcome.err
    out = tmp_path / "out"
    for name in ("table.md", "table.json", "table.png", "learning_curves.png", "workspace.png"):
        assert (out / name).is_file()
        assert f"out/{name}" in outcome.out
    assert "A very small one." in outcome.out
    entries = json.loads((tmp_path / "out.json").read_text())
    assert entries == json.loads((out / "table.json").read_text())
    assert [(entry["policy"], entry["seeds"]) for entry in entries] == [
        ("sac", 2),
        ("follow_ee", 1),
    ]
    assert sorted(path.name for path in (out / "runs").iterdir()) == ["pr2-sac-0", "pr2-sac-1"]
    assert pretrained.robots(tmp_path / "ship") == pretrained.robots(out / "pretrained") == ["pr2"]
    about = json.loads((tmp_path / "ship" / "pr2" / "policy.json").read_text())
    assert about["command"].startswith("kinfeas train --robot pr2")
    assert about["benchmark"]["ggr"]["episodes"] == 2

    # A second time nothing is computed, and a run can be judged without the study that made it.
    monkeypatch.setattr(jobs, "compute", None)
    before = (out / "table.json").read_bytes()
    again = run(kinfeas, "--config", study)
    assert again.code == 0, again.err
    assert "training" not in again.err
    assert (out / "table.json").read_bytes() == before
    assert run(kinfeas, "--config", study, "--runs", "out/runs").code == 0
    assert (out / "table.json").read_bytes() == before


def test_interruption_says_how_to_go_on(kinfeas, study, monkeypatch):
    def interrupted(_):
        raise KeyboardInterrupt

    monkeypatch.setattr(jobs, "compute", interrupted)
    outcome = run(kinfeas, "--config", study, "--set", "seeds=[0]")
    assert outcome.code == 130
    assert outcome.err.endswith("the same command continues\n")
    assert "Traceback" not in outcome.err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--config", "benchmark/none"), "benchmark/none"),
        (("--config", "benchmark/paper"), "analytic"),
        (("--set", "episodes=0"), "episodes"),
        (("--set", "episods=3"), "did you mean 'episodes'"),
        (("--set", "tasks=[fly]"), "'fly'"),
        (("--policy", "follow_ee"), "pretrained only"),
        (("--policy", "pretrained", "--runs", "runs"), "not beside --runs"),
        (("--policy", "pretrained", "--set", "robots=[pr2]"), "no pretrained policy for robot"),
        (("--runs", "nowhere"), "not a training run"),
        (("--json", "nowhere/out.json"), "cannot be written"),
    ],
)
def test_bad_input_is_one_line(kinfeas, study, tmp_path, arguments, words, monkeypatch):
    monkeypatch.setattr(pretrained, "_shipped", lambda: tmp_path / "none")
    first = () if "--config" in arguments else ("--config", study)
    outcome = run(kinfeas, *first, *arguments)
    assert is_one_line(outcome), outcome.err
    assert words in outcome.err
    assert not (tmp_path / "out").exists()


def test_a_baseline_that_cannot_be_is_refused_before_any_training(kinfeas, study, monkeypatch):
    def missing(name, robot):
        raise KinfeasError("no such library")

    monkeypatch.setattr(jobs, "load_policy", missing)
    outcome = run(kinfeas, "--config", study)
    assert is_one_line(outcome), outcome.err
    assert outcome.err == "error: no such library\n"


def test_publishing_needs_runs(kinfeas, study, tmp_path, monkeypatch):
    monkeypatch.setattr(pretrained, "find", lambda name, root=None: tmp_path)
    arguments = ("--policy", "pretrained", "--publish", "ship")
    outcome = run(kinfeas, "--config", study, *arguments)
    assert is_one_line(outcome), outcome.err
    assert "--publish" in outcome.err


PHYSICS = """
robots: [hsr]
tasks: [ggr]
policies: pretrained
baselines: {follow_ee: [ggr]}
backend: pybullet
settings: ["world.max_seconds=0.3"]
"""


def test_physics_stand_beside_the_same_without(kinfeas, tmp_path):
    pytest.importorskip("pybullet")
    (tmp_path / "physics.yaml").write_text(PHYSICS)
    arguments = ("--config", "physics.yaml", "--world", "pybullet", "--episodes", "2")
    outcome = run(kinfeas, *arguments, "--json", "out.json")
    assert outcome.code == 0, outcome.err
    assert outcome.out.splitlines()[-3:] == ["out/table.png", "out/table.md", "out/table.json"]
    entries = json.loads((tmp_path / "out.json").read_text())
    assert [(entry["policy"], entry["world"]) for entry in entries] == [
        ("pretrained", "pybullet"),
        ("follow_ee", "pybullet"),
    ]
    assert entries[0]["analytic_success"] is not None
    assert entries[0]["paper_success"] == 0.644


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--config", "benchmark/physics"), "--world"),
        (("--config", "benchmark/study", "--world", "pybullet"), "--world"),
        (("--world", "pybullet", "--publish", "ship"), "--publish"),
    ],
)
def test_each_study_has_its_world(kinfeas, arguments, words):
    outcome = run(kinfeas, *arguments)
    assert is_one_line(outcome), outcome.err
    assert words in outcome.err
