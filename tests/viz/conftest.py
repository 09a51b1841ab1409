import pytest

from kinfeas.core import registry
from kinfeas.envs.world import World, WorldConfig
from kinfeas.evaluation.recording import record_episodes
from kinfeas.policies.loading import load_policy


@pytest.fixture(scope="session")
def recordings(hsr):
    task = registry.build("kinfeas.tasks", "ggr", {})
    world = World(hsr, task, WorldConfig(max_failures=9, max_seconds=15.0), seed=1)
    return record_episodes(world, load_policy("follow_ee", hsr), 2)
