"""Runs of a few hundred steps."""

import pytest

from kinfeas import config
from kinfeas.training.config import TrainConfig
from kinfeas.training.train import train

TINY = {
    "robot": "hsr", "num_envs": 8,
    "world": {"max_seconds": 1.5, "adapters": [{"name": "base_noise"}]},
    "learner": {
        "net_arch": [16, 16], "batch_size": 32, "learning_starts": 80, "buffer_size": 240,
        "ent_coef": "learned",
    },
    "schedule": {
        "steps": 320, "minutes": None, "evaluations": 2, "evaluation_episodes": 2,
        "final_episodes": 2, "checkpoint_seconds": 0.05,
    },
}  # fmt: skip


@pytest.fixture(scope="session")
def tiny():
    """Return a function that returns the configuration of a small run, changed by settings."""
    return lambda settings=None: config.from_mapping(TrainConfig, TINY, "tiny", settings)


@pytest.fixture(scope="session")
def whole(tiny, tmp_path_factory):
    out = tmp_path_factory.mktemp("whole") / "run"
    train(tiny(), out)
    return out
