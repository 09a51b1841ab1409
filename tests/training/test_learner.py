from dataclasses import replace

import numpy as np
import pytest
import torch

from kinfeas.control.observation import scaled
from kinfeas.core import registry
from kinfeas.envs.world import World
from kinfeas.policies.network import read_network, write_network
from kinfeas.robots.loading import load_robot
from kinfeas.training.learner import (
    DEVIATION,
    explore,
    make_learner,
    network_of,
    take_network,
    without_denormals,
)
from kinfeas.training.vec_env import WorldVecEnv


@pytest.fixture(scope="module")
def env(tiny):
    robot, task = load_robot("pr2"), registry.build("kinfeas.tasks", "ggr", {})
    return WorldVecEnv(World(robot, task, tiny().world, 0), 8)


@pytest.fixture(params=["sac", "td3"])
def config(request, tiny):
    return tiny(f"learner.algorithm={request.param}").learner


def observations(env, n=50, seed=0):
    """Return what is seen at the start of n episodes, not scaled."""
    return env.world.start(range(seed, seed + n))


@pytest.mark.parametrize("net_arch", [(16, 16), (8,), (32, 16, 8)])
def test_the_network_acts_as_the_actor_does(config, env, net_arch):
    learner = make_learner(replace(config, net_arch=net_arch), env, 0)
    with torch.no_grad():
        for parameter in learner.actor.parameters():
            parameter.mul_(3.0)  # so that no action is near 0
    seen = observations(env)
    expected, _ = learner.predict(scaled(seen, env.scale), deterministic=True)
    found = network_of(learner, env.scale)(seen)
    assert np.abs(expected).max() > 0.5
    np.testing.assert_allclose(found, expected, atol=1e-5)


def test_the_network_is_a_copy(config, env):
    learner = make_learner(config, env, 0)
    network, seen = network_of(learner, env.scale), observations(env)
    before = network(seen)
    with torch.no_grad():
        for parameter in learner.actor.parameters():
            parameter.add_(1.0)
    np.testing.assert_array_equal(network(seen), before)


def test_a_written_network_reads_back_to_the_bit(config, env, tmp_path):
    network = network_of(make_learner(config, env, 0), env.scale)
    write_network(network, tmp_path, env.world.robot, {"steps": 3})
    seen = observations(env)
    read = read_network(tmp_path, env.world.robot)
    np.testing.assert_array_equal(read(seen), network(seen))


def test_random_actions_are_uniform_and_come_from_torch(config, env):
    learner = make_learner(config, env, 0)
    seen = np.zeros((20_000, env.world.observation_size), dtype=np.float32)
    state = torch.get_rng_state()
    first = explore(learner, config, seen, random=True)
    second = explore(learner, config, seen, random=True)
    torch.set_rng_state(state)
    np.testing.assert_array_equal(explore(learner, config, seen, random=True), first)
    assert not np.array_equal(first, second)
    assert first.dtype == np.float32
    assert first.shape == (20_000, 3)
    assert np.abs(first).max() <= 1.0
    counts, _ = np.histogram(first, bins=10, range=(-1.0, 1.0))
    assert np.abs(counts / first.size - 0.1).max() < 0.01
    assert np.abs(np.corrcoef(first.T) - np.eye(3)).max() < 0.03


def test_exploration_scatters_about_the_actor(config, env):
    learner = make_learner(config, env, 0)
    one = env.reset()[:1]
    actions = explore(learner, config, np.repeat(one, 4_000, axis=0), random=False)
    assert np.abs(actions).max() <= 1.0
    assert actions.std(axis=0).min() > 0.1
    mean, _ = learner.predict(one, deterministic=True)
    np.testing.assert_allclose(actions.mean(axis=0), mean[0], atol=0.1)
    state = torch.get_rng_state()
    first = explore(learner, config, one, random=False)
    torch.set_rng_state(state)
    np.testing.assert_array_equal(explore(learner, config, one, random=False), first)


def test_td3_explores_as_much_as_it_is_told(env, tiny):
    config = tiny("learner.algorithm=td3", "learner.exploration_noise=0").learner
    learner, seen = make_learner(config, env, 0), env.reset()
    expected, _ = learner.predict(seen, deterministic=True)
    np.testing.assert_allclose(explore(learner, config, seen, random=False), expected, atol=1e-6)


def test_the_same_seed_makes_the_same_learner(config, env):
    first, second, other = (make_learner(config, env, seed).policy for seed in (3, 3, 4))
    for one, same in zip(first.parameters(), second.parameters(), strict=True):
        assert torch.equal(one, same)
    different = zip(first.parameters(), other.parameters(), strict=True)
    assert any(not torch.equal(*pair) for pair in different)


@pytest.mark.parametrize(
    ("schedule", "half", "end"), [("constant", 6e-4, 6e-4), ("linear", 3e-4, 0.0)]
)
def test_the_learning_rate_follows_its_schedule(env, tiny, schedule, half, end):
    config = tiny(f"learner.schedule={schedule}", "learner.learning_rate=6e-4").learner
    rate = make_learner(config, env, 0).lr_schedule
    np.testing.assert_allclose([rate(1.0), rate(0.5), rate(0.0)], [6e-4, half, end])


def test_hyperparameters_reach_sb3(env, tiny):
    sac = make_learner(tiny("learner.ent_coef=0.3", "learner.gamma=0.9").learner, env, 0)
    assert (sac.gamma, float(sac.ent_coef_tensor), sac.tau) == (0.9, pytest.approx(0.3), 0.005)
    learned = make_learner(tiny("learner.ent_coef=learned").learner, env, 0)
    assert learned.ent_coef_optimizer is not None
    td3 = make_learner(tiny("learner.algorithm=td3", "learner.policy_noise=0.5").learner, env, 0)
    assert td3.target_policy_noise == 0.5
    assert td3.replay_buffer.handle_timeout_termination


def test_denormals_are_flushed_for_a_while_only():
    tiny = np.full(1, 1e-310)
    with without_denormals():
        assert (tiny * 1.0).item() == 0.0
    assert (tiny * 1.0).item() == 1e-310


def test_a_learner_acts_as_the_network_that_it_takes(config, env):
    network = network_of(make_learner(config, env, 0), env.scale)
    learner = make_learner(config, env, 1)
    take_network(learner, network)
    seen = observations(env)
    np.testing.assert_array_equal(network_of(learner, env.scale)(seen), network(seen))
    if config.algorithm == "td3":
        for own, target in zip(
            learner.actor.parameters(), learner.actor_target.parameters(), strict=True
        ):
            np.testing.assert_array_equal(own.detach(), target.detach())
    else:
        explored = np.arctanh(explore(learner, config, scaled(seen, env.scale), random=False))
        spread = np.std(explored - np.arctanh(network(seen)))
        assert spread == pytest.approx(DEVIATION, rel=0.3)
