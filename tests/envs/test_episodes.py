import os
import signal
from concurrent.futures import ProcessPoolExecutor

import numpy as np
import pytest

from kinfeas.config import PluginSpec
from kinfeas.envs import episodes as module
from kinfeas.envs.episodes import WorkerContext, begin_worker, run_episodes, terminate
from kinfeas.envs.world import World, WorldConfig
from kinfeas.policies.baselines.following import FollowEe
from kinfeas.tasks.ggr import ggr
from kinfeas.tasks.loading import load_task

NOISY = WorldConfig(
    max_failures=9, max_seconds=12.0, adapters=(PluginSpec("base_noise", {"linear": 0.05}),)
)
NEAR = ggr(distance=(0.3, 0.9), heights=(0.6, 0.9))


@pytest.fixture(scope="module")
def world(hsr):
    return World(hsr, NEAR, NOISY, seed=2)


@pytest.fixture(scope="module")
def policy(world):
    return FollowEe(world.robot.base)


@pytest.fixture(scope="module")
def records(world, policy):
    return run_episodes(world, policy, 24)


def assert_equal(result, records, rows=slice(None)):
    for key, values in vars(result).items():
        expected = getattr(records, key)
        np.testing.assert_array_equal(values, expected if expected is None else expected[rows])


def test_no_figure_depends_on_the_batch_and_the_other_episodes(world, policy, records, monkeypatch):
    monkeypatch.setattr(module, "BATCH", 5)
    assert_equal(run_episodes(world, policy, 24), records)
    assert_equal(run_episodes(world, policy, 3, first=20), records, slice(20, 23))


def test_records_are_sums_over_the_steps(world, policy, records):
    episode = 11
    world.start([episode])
    seen = []
    while not seen or not seen[-1].done.any():
        seen.append(world.step(policy.act(world.loop.observation)))
    deviation = np.array([one.outcome.deviation[0] for one in seen])
    assert records.steps[episode] == len(seen)
    assert records.failures[episode] == sum(not one.outcome.feasible[0] for one in seen)
    assert records.joint_jumps[episode] == sum(one.outcome.joint_jump[0] for one in seen)
    assert records.reached[episode] == seen[-1].reached[0]
    assert records.final_distance[episode] == seen[-1].outcome.goal_distance[0]
    assert records.max_deviation[episode] == deviation.max()
    assert records.mean_deviation[episode] == pytest.approx(deviation.mean())


def test_an_episode_that_never_begins_its_last_sub_goal_ends_far_from_it(world, policy):
    short = WorldConfig(max_seconds=0.3)
    records = run_episodes(World(world.robot, load_task("pick_place"), short, seed=0), policy, 3)
    assert np.isinf(records.final_distance).all()
    assert not records.within.any()


def test_workers_delay_ctrl_c_until_they_have_begun():
    context = WorkerContext()
    before = set(context.active_children())
    pool = ProcessPoolExecutor(1, context, begin_worker, (signal.SIG_IGN,))
    try:
        result = pool.submit(abs, -1)
        (worker,) = set(context.active_children()) - before
        os.kill(worker.pid, signal.SIGINT)
        assert result.result(60.0) == 1
    finally:
        terminate(pool)
