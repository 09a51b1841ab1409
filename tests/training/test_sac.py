"""Updates that are cheaper than Stable-Baselines3's, and equal to them."""

import numpy as np
import pytest
import torch
from stable_baselines3 import SAC

from kinfeas.envs.world import World, WorldConfig
from kinfeas.robots.loading import load_robot
from kinfeas.tasks.loading import load_task
from kinfeas.training import learner as learners
from kinfeas.training.config import LearnerConfig
from kinfeas.training.learner import explore, make_learner
from kinfeas.training.sac import AnchoredSAC
from kinfeas.training.vec_env import WorldVecEnv


def filled(config, kind=AnchoredSAC):
    """Return a learner with some experience."""
    env = WorldVecEnv(World(load_robot("pr2"), load_task("ggr"), WorldConfig(), 0), 8)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(learners, "AnchoredSAC", kind)
        learner = make_learner(config, env, seed=0)
    seen = env.reset()
    for _ in range(8):
        action = explore(learner, config, seen, random=True)
        env.step_async(action)
        after, rewards, dones, infos = env.step_wait()
        learner.replay_buffer.add(seen, after, action, rewards, dones, infos)
        seen = after
    env.close()
    return learner


def numbers(module):
    return [values.detach().clone() for values in module.parameters()]


@pytest.mark.parametrize("ent_coef", [0.01, "learned"])
def test_without_an_anchor_updates_equal_those_of_stable_baselines3(ent_coef):
    config = LearnerConfig(net_arch=(16, 16), batch_size=16, ent_coef=ent_coef)
    ours, theirs = filled(config), filled(config, SAC)
    # Making the second learner has seeded torch and NumPy anew.
    for one in (ours, theirs):
        torch.manual_seed(1)
        np.random.seed(1)  # noqa: NPY002 - SB3 draws from it
        one.train(10, 16)
    for mine, other in zip(numbers(ours.policy), numbers(theirs.policy), strict=True):
        assert torch.equal(mine, other)


def test_an_anchor_holds_the_actor():
    config = LearnerConfig(net_arch=(16, 16), batch_size=16, learning_rate=1e-2)
    away = []
    for weight in (0.0, 100.0):
        learner = filled(config)
        before = learner.actor(torch.zeros(1, 28), deterministic=True)
        learner.anchor(weight)
        learner.train(200, 16)
        after = learner.actor(torch.zeros(1, 28), deterministic=True)
        away.append(float((after - before).norm()))
    assert away[1] < 0.2 * away[0]


def test_a_frozen_actor_stays_while_the_critics_learn():
    learner = filled(LearnerConfig(net_arch=(16, 16), batch_size=16))
    actor, critic = numbers(learner.actor), next(learner.critic.parameters()).clone()
    learner.actor.requires_grad_(False)
    learner.train(5, 16)
    assert all(map(torch.equal, actor, learner.actor.parameters()))
    assert not torch.equal(critic, next(learner.critic.parameters()))
