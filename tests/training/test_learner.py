from dataclasses import replace

import numpy as np
import pytest
import torch
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.torch_layers import FlattenExtractor
from torch import nn

from kinfeas.control.observation import scaled
from kinfeas.core.errors import KinfeasError
from kinfeas.envs.world import World, WorldConfig
from kinfeas.policies.network import read_network, write_network
from kinfeas.robots.loading import load_robot
from kinfeas.tasks.loading import load_task
from kinfeas.training import learner as learners
from kinfeas.training.config import LearnerConfig
from kinfeas.training.learner import (
    INITIAL_STD,
    FastSAC,
    explore,
    make_learner,
    network_of,
    save_policy,
    take_network,
)
from kinfeas.training.vec_env import WorldVecEnv

SMALL = LearnerConfig(net_arch=(16, 16), batch_size=16)


@pytest.fixture(scope="module")
def env():
    env = WorldVecEnv(World(load_robot("hsr"), load_task("ggr"), WorldConfig(), 0), 8)
    yield env
    env.close()


def observations(env, n=50):
    return env.world.start(range(n))


@pytest.mark.parametrize("net_arch", [(8,), (32, 16, 8)])
def test_the_network_acts_as_the_actor_and_is_a_copy(env, net_arch, tmp_path):
    learner = make_learner(replace(SMALL, net_arch=net_arch), env, 0)
    with torch.no_grad():
        for parameter in learner.actor.parameters():
            parameter.mul_(3.0)  # so that no action is near 0
    seen = observations(env)
    expected, _ = learner.predict(scaled(seen, env.scale), deterministic=True)
    network = network_of(learner, env)
    found = network(seen)
    assert np.abs(expected).max() > 0.5
    np.testing.assert_allclose(found, expected, atol=1e-5)
    with torch.no_grad():
        for parameter in learner.actor.parameters():
            parameter.add_(1.0)
    np.testing.assert_array_equal(network(seen), found)
    write_network(network, tmp_path, env.robot, {"steps": 3})
    np.testing.assert_array_equal(read_network(tmp_path, env.robot)(seen), found)


class Doubled(FlattenExtractor):
    def forward(self, observations):
        return 2.0 * super().forward(observations)


@pytest.mark.parametrize(("options", "named"), [
    ({"activation_fn": nn.Tanh}, "Tanh"), ({"features_extractor_class": Doubled}, "Doubled"),
])  # fmt: skip
def test_only_actors_that_the_format_holds_are_saved(env, options, named, tmp_path):
    save_policy(SAC("MlpPolicy", env), env, tmp_path)
    with pytest.raises(KinfeasError, match=named):
        save_policy(SAC("MlpPolicy", env, policy_kwargs=options), env, tmp_path)
    with pytest.raises(KinfeasError, match="PPO"):
        save_policy(PPO("MlpPolicy", env), env, tmp_path)


@pytest.mark.parametrize(
    ("schedule", "half", "end"), [("constant", 6e-4, 6e-4), ("linear", 3e-4, 0.0)]
)
def test_hyperparameters_reach_sb3(env, schedule, half, end):
    chosen = replace(
        SMALL, schedule=schedule, learning_rate=6e-4, ent_coef=0.3, gamma=0.9, tau=0.02
    )
    sac = make_learner(chosen, env, 0)
    rates = [sac.lr_schedule(remaining) for remaining in (1.0, 0.5, 0.0)]
    np.testing.assert_allclose(rates, [6e-4, half, end])
    assert (sac.gamma, float(sac.ent_coef_tensor), sac.tau) == (0.9, pytest.approx(0.3), 0.02)
    learned = make_learner(replace(SMALL, ent_coef="learned"), env, 0)
    assert learned.ent_coef_optimizer is not None


def test_a_learner_acts_as_the_network_that_it_takes(env):
    network = network_of(make_learner(SMALL, env, 0), env)
    learner = make_learner(SMALL, env, 1)
    take_network(learner, network)
    seen = observations(env)
    np.testing.assert_array_equal(network_of(learner, env)(seen), network(seen))
    explored = np.arctanh(explore(learner, scaled(seen, env.scale), random=False))
    assert np.std(explored - np.arctanh(network(seen))) == pytest.approx(INITIAL_STD, rel=0.3)


def filled(env, config, kind=FastSAC):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(learners, "FastSAC", kind)
        learner = make_learner(config, env, seed=0)
    seen = env.reset()
    for _ in range(8):
        action = explore(learner, seen, random=True)
        after, rewards, dones, infos = env.step(action)
        learner.replay_buffer.add(seen, after, action, rewards, dones, infos)
        seen = after
    return learner


@pytest.mark.parametrize("ent_coef", [0.01, "learned"])
def test_updates_equal_those_of_sb3(env, ent_coef):
    config = replace(SMALL, ent_coef=ent_coef, net_arch=(16, 24, 16))
    ours, theirs = filled(env, config), filled(env, config, SAC)
    ours.use(torch.float32)
    with torch.no_grad():
        for one in (ours, theirs):
            one.actor.log_std.weight.mul_(100.0)  # beyond its bounds in some dimensions
    for one in (ours, theirs):
        torch.manual_seed(1)
        one.train(3, 16)
    pairs = zip(ours.policy.parameters(), theirs.policy.parameters(), strict=True)
    for mine, other in pairs:
        torch.testing.assert_close(mine, other, rtol=1e-3, atol=1e-5)
    assert ours.num_timesteps == theirs.num_timesteps
    torch.testing.assert_close(ours.log_ent_coef, theirs.log_ent_coef)


def test_the_actor_learns_less_often_than_the_critics(env):
    learner = filled(env, replace(SMALL, policy_delay=3))
    learner.train(1, 16)
    before = learner.actor.mu.weight.clone()
    learner.train(2, 16)
    assert torch.equal(learner.actor.mu.weight, before)
    learner.train(1, 16)
    assert not torch.equal(learner.actor.mu.weight, before)


def test_sampled_transitions_are_those_added(env):
    buffer = make_learner(SMALL, env, 0).replay_buffer
    shape = (8, *env.observation_space.shape)
    for step in range(3):
        seen = np.full(shape, step, dtype=np.float32)
        ends = np.arange(8) >= 4  # the last two by the time limit
        infos = [{"TimeLimit.truncated": row >= 6} for row in range(8)]
        buffer.add(seen, seen + 0.5, np.zeros((8, 3)) + step, np.arange(8.0) + step, ends, infos)
    data = buffer.sample(500)
    step = data.observations[:, 0]
    assert set(step.tolist()) == {0.0, 1.0, 2.0}
    assert torch.equal(data.next_observations, data.observations + 0.5)
    assert torch.equal(data.actions[:, 2], step)
    row = data.rewards[:, 0] - step
    assert torch.equal(data.dones[:, 0] == 1.0, (row >= 4) & (row < 6))


def test_an_anchor_holds_only_where_nothing_is_around(env):
    size = env.observation_space.shape[0]
    network = network_of(make_learner(SMALL, env, 0), env)
    network.weights[0][-1] = 0.0  # an input that the network ignores
    seen, away = torch.zeros(2, size), []
    seen[1, -1] = 1.0
    for around in ([], [size - 2, size - 1]):
        learner = filled(env, replace(SMALL, learning_rate=3e-3))
        take_network(learner, network, 100.0, around)
        before = learner.actor(seen, deterministic=True).detach()
        learner.replay_buffer.observations[::2, :, -1] = 0.0
        learner.train(400, 64)
        after = learner.actor(seen, deterministic=True).detach()
        away.append((after - before).norm(dim=1).tolist())
    assert away[1][0] < 0.2 * away[1][1]
    assert away[0][1] < away[1][1]
