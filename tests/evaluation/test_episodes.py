import numpy as np
import pytest

from kinfeas.config import PluginSpec
from kinfeas.envs.world import World, WorldConfig
from kinfeas.evaluation.episodes import run_episodes
from kinfeas.policies.baselines.follow_ee import FollowEe
from kinfeas.tasks.chain import pick_place
from kinfeas.tasks.ggr import ggr

CONFIG = WorldConfig(
    max_failures=9, max_seconds=12.0, adapters=(PluginSpec("base_noise", {"linear": 0.05}),)
)
NEAR = ggr(distance=(0.3, 0.9), heights=(0.6, 0.9))


@pytest.fixture(scope="session")
def world(robot):
    return World(robot, NEAR, CONFIG, seed=2)


@pytest.fixture(scope="session")
def policy(robot):
    return FollowEe(robot.base)


@pytest.fixture(scope="session")
def records(world, policy):
    return run_episodes(world, policy, 24)


def replay(world, policy, episode):
    """Return the transitions of one episode, run alone and by hand."""
    world.start([episode])
    seen = []
    while not seen or not seen[-1].done.any():
        seen.append(world.step(policy.act(world.loop.policy_input)))
    return seen


@pytest.mark.parametrize("batch", [1, 3, 64])
def test_no_figure_depends_on_the_batch(world, policy, records, batch):
    found = run_episodes(world, policy, 24, batch=batch)
    for key, values in vars(records).items():
        np.testing.assert_array_equal(getattr(found, key), values, err_msg=key)


def test_the_first_episodes_are_the_same_whatever_their_number(world, policy, records):
    found = run_episodes(world, policy, 5)
    for key, values in vars(records).items():
        np.testing.assert_array_equal(getattr(found, key), values[:5], err_msg=key)


@pytest.mark.parametrize("episode", [0, 11, 23])
def test_records_are_sums_over_the_episode(world, policy, records, episode):
    seen = replay(world, policy, episode)
    deviation = np.array([one.step.deviation[0] for one in seen])
    assert records.steps[episode] == len(seen)
    assert records.failures[episode] == sum(not one.step.feasible[0] for one in seen)
    assert records.joint_jumps[episode] == sum(one.step.joint_jump[0] for one in seen)
    assert records.reached[episode] == seen[-1].reached[0]
    assert records.final_distance[episode] == seen[-1].step.goal_distance[0]
    assert records.max_deviation[episode] == deviation.max()
    assert records.mean_deviation[episode] == pytest.approx(deviation.mean(), rel=1e-12)


def test_episodes_end_as_the_world_says(records):
    assert records.steps.max() <= 120
    assert records.failures.max() <= 10
    too_many, too_long = records.failures == 10, records.steps == 120
    assert np.all(records.reached | too_many | too_long)
    assert not np.any(records.reached & too_many)
    assert len(set(records.steps.tolist())) > 1


def test_progress_and_what_is_watched(world, policy, records):
    ended, steps = [], np.zeros(24, dtype=int)

    def watch(seen, transition, rows, episodes):
        assert seen is world
        assert len(rows) == len(set(rows)) == len(episodes) <= 5
        assert transition.reward.shape == (5,)
        steps[episodes] += 1

    run_episodes(world, policy, 24, ended.append, watch, batch=5)
    assert sum(ended) == 24
    assert min(ended) > 0
    np.testing.assert_array_equal(steps, records.steps)


def test_who_never_begins_the_last_leg_is_not_near_its_end(robot):
    config = WorldConfig(max_failures=10**6, max_seconds=3.0)
    records = run_episodes(World(robot, pick_place(), config, seed=0), FollowEe(robot.base), 3)
    assert np.all(np.isinf(records.final_distance))
    assert not records.within.any()
    assert np.all(records.steps == 30)
