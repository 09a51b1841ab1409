import json

import pytest

from kinfeas import config
from kinfeas.training.config import TrainConfig
from tests.builders import TRAINING
from tests.cli.conftest import check_one_line

pytest.importorskip("optuna")
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
