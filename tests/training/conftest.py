"""Runs so small that they take a few seconds."""

import hashlib
from pathlib import Path

import pytest

from kinfeas import config
from kinfeas.training.config import TrainConfig

TINY = {
    "num_envs": 8,
    "world": {"max_seconds": 5.0, "adapters": [{"name": "base_noise"}]},
    "learner": {
        "net_arch": [16, 16],
        "batch_size": 32,
        "learning_starts": 200,
        "buffer_size": 1_000,
        "gradient_steps": 1,
    },
    "schedule": {
        "steps": 1_600,
        "minutes": None,
        "evaluations": 2,
        "evaluation_episodes": 4,
        "final_episodes": 4,
        "checkpoint_seconds": 0.2,
    },
}


def _tiny(*overrides: str) -> TrainConfig:
    return config.from_mapping(TrainConfig, TINY, "tiny", overrides)


def _digest(folder: Path) -> dict[str, str]:
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {str(p.relative_to(folder)): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


@pytest.fixture(scope="session")
def tiny():
    """Return a configuration with overrides as `--set` takes them."""
    return _tiny


@pytest.fixture(scope="session")
def digest():
    """Return what tells whether anything in a folder has changed."""
    return _digest
