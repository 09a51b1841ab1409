import json

import pytest

from kinfeas.benchmark import evaluations
from kinfeas.config.recipes import default_engine
from tests.builders import TRAINING

STUDY = f"""
note: A very small one.
robots: [hsr]
tasks: [ggr]
baselines: {{follow_ee: [ggr]}}
trainings:
  - {{robot: hsr, steps: 64, settings: {json.dumps(TRAINING)}}}
seeds: [0, 1]
episodes: 2
settings: {{world.max_seconds: 2.5}}
"""
PHYSICS = f"""
robots: [hsr]
tasks: [ggr]
policies: pretrained
baselines: {{follow_ee: [ggr]}}
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
    words = ("--config", "physics.yaml", "--world", engine, "--episodes", "1")
    entries = run(*words, "--json", "out.json", code=0).facts
    rows = [(entry["policy"], entry["row"]) for entry in entries]
    assert rows == [("pretrained", ""), ("pretrained", "late"), ("follow_ee", "")]
    assert {entry["world"] for entry in entries} == {engine}
    assert None not in [entry["analytic_success"] for entry in entries]
