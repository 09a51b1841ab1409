import numpy as np
import pytest

from kinfeas.benchmark.samples import EVERY, MOST, WorkspaceSamples, thinned
from kinfeas.envs.episodes import run_episodes
from kinfeas.envs.world import World, WorldConfig
from kinfeas.policies.loading import load_policy
from kinfeas.robots.loading import load_robot
from kinfeas.tasks.ggr import ggr


@pytest.fixture(scope="module")
def seen():
    robot = load_robot("tiago")
    world = World(robot, ggr(), WorldConfig(max_failures=9, max_seconds=10.0), seed=1)
    samples = WorkspaceSamples()
    return run_episodes(world, load_policy("follow_ee", robot), 6, watch=samples), samples.kept()


def test_every_failure_and_some_of_the_rest(seen):
    records, kept = seen
    assert len(kept["infeasible"]) == records.failures.sum() > 0
    assert 0 < len(kept["feasible"]) <= records.steps.sum() / EVERY


def test_points_are_near_the_robot(seen):
    points = np.array(seen[1]["feasible"])
    assert points.shape[1] == 3
    assert np.all(np.linalg.norm(points[:, :2], axis=1) < 1.5)
    assert np.all((points[:, 2] > -0.3) & (points[:, 2] < 2.5))


@pytest.mark.parametrize(("count", "kept"), [(0, 0), (1, 1), (MOST, MOST), (3 * MOST, MOST)])
def test_thinning_spreads_evenly(count, kept):
    points = np.repeat(np.arange(count, dtype=float)[:, np.newaxis], 3, axis=1)
    thin = thinned(points, MOST)
    assert thin.shape == (kept, 3)
    if kept > 1:
        assert (thin[0, 0], thin[-1, 0]) == (0.0, count - 1.0)


def test_nothing_seen_is_nothing_kept():
    assert WorkspaceSamples().kept() == {"feasible": [], "infeasible": []}
