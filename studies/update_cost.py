"""Print the CPU time of a gradient step of SAC for variants of the learner, on one core.

    python studies/update_cost.py tiago

Each figure is the lowest of many updates of one critic and one actor step, from random transitions.
"""

import argparse
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from speed import one_core
from stable_baselines3 import SAC
from time_to_level import recipe_of

from kinfeas.training.fast_sac import FastSAC
from kinfeas.training.learner import make_learner, without_denormals
from kinfeas.training.vec_env import WorldVecEnv
from kinfeas.training.worlds import training_world


def cost(learner: SAC, batch_size: int) -> float:
    """Return the CPU time of an update, milliseconds: the tenth percentile of 200."""
    seconds = []
    for _ in range(200):
        start = time.thread_time()
        learner.train(1, batch_size)
        seconds.append(time.thread_time() - start)
    return 1e3 * float(np.quantile(seconds, 0.1))


def main() -> None:
    """Measure all variants and print a row for each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("robot")
    robot = parser.parse_args().robot
    config = recipe_of(robot, {})
    env = WorldVecEnv(training_world(config), config.num_envs)
    observation: Any = env.reset()
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (len(observation), env.world.action_size))
    transition: Any = env.step(actions)
    after, rewards, dones, infos = transition
    width = len(config.learner.net_arch)

    def ours(dtype: torch.dtype, **changes: Any) -> tuple[SAC, int]:
        settings = replace(config.learner, **changes)
        learner = make_learner(settings, env, 0)
        assert isinstance(learner, FastSAC)
        learner.use(dtype)
        return learner, settings.batch_size

    def theirs() -> tuple[SAC, int]:
        options = {"net_arch": list(config.learner.net_arch), "optimizer_kwargs": {"fused": True}}
        arguments: dict[str, Any] = {"ent_coef": 0.01, "learning_rate": 6e-4, "device": "cpu"}
        learner = SAC("MlpPolicy", env, policy_kwargs=options, **arguments)
        learner.set_logger(ours(torch.float32)[0].logger)
        return learner, config.learner.batch_size

    variants: dict[str, Callable[[], tuple[SAC, int]]] = {
        "Stable-Baselines3": theirs,
        "float32": lambda: ours(torch.float32),
        "bfloat16": lambda: ours(torch.bfloat16),
        "bfloat16, 128 units": lambda: ours(torch.bfloat16, net_arch=(128,) * width),
        "bfloat16, batch of 128": lambda: ours(torch.bfloat16, batch_size=128),
        "bfloat16, batch of 512": lambda: ours(torch.bfloat16, batch_size=512),
        "bfloat16, critics alone": lambda: ours(torch.bfloat16, policy_delay=100),
    }
    with one_core(), without_denormals():
        for name, make in variants.items():
            learner, batch_size = make()
            assert learner.replay_buffer is not None
            for _ in range(20):
                learner.replay_buffer.add(observation, after, actions, rewards, dones, infos)
            print(f"{cost(learner, batch_size):6.2f} ms  {name}", flush=True)
    env.close()


if __name__ == "__main__":
    main()
