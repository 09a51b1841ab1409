"""Train a robot with PPO of Stable-Baselines3 and print success by CPU time, on one core.

    python studies/ppo.py pr2 --seconds 20 150

Each time is a run of its own, whose learning rate falls to 0. Reward and adapters are those of the
robot's recipe. `--bootstrap` treats the end of an episode by failures as one by the time limit;
without it, HSR learns to fail early, because each of its steps costs something.
"""

import argparse
import time
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnvWrapper
from time_to_level import recipe_of
from torch import nn

from kinfeas.core.metrics import summarize
from kinfeas.policies.network import Network
from kinfeas.training.config import TrainConfig
from kinfeas.training.fast_sac import linear_layers
from kinfeas.training.learner import without_denormals
from kinfeas.training.vec_env import WorldVecEnv
from kinfeas.training.worlds import evaluate_network, training_world


def main() -> None:
    """Train once for each time and print the evaluations."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("robot")
    parser.add_argument("--seconds", type=float, nargs="+", default=[20.0])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--episodes", type=int, default=512)
    parser.add_argument("--bootstrap", action="store_true")
    options = parser.parse_args()
    torch.set_num_threads(1)
    recipe = {"seed": options.seed, "num_envs": 256, "action_repeat": 2}
    config = recipe_of(options.robot, recipe)
    for seconds in options.seconds:
        env = _Squashed(config, bootstrap=options.bootstrap)
        network, steps = _trained(env, seconds, options.seed)
        figures = summarize(evaluate_network(config, network, options.episodes))
        print(
            f"{options.robot}, {seconds:g} s, {steps / 1e6:.2f} million control steps: success "
            f"{figures['success']:.1%}, within 5 cm {figures['within_5cm']:.1%}",
            flush=True,
        )
        env.close()


class _Squashed(VecEnvWrapper):
    """Environments whose actions are squashed by tanh, as at the end of a `Network`."""

    def __init__(self, config: TrainConfig, *, bootstrap: bool) -> None:
        self.inner = WorldVecEnv(training_world(config), config.num_envs, config.action_repeat)
        super().__init__(
            self.inner, action_space=spaces.Box(-10.0, 10.0, self.inner.action_space.shape)
        )
        self._bootstrap = bootstrap

    def reset(self) -> Any:
        return self.inner.reset()

    def step_async(self, actions: Any) -> None:
        self.inner.step_async(np.tanh(actions))

    def step_wait(self) -> Any:
        observation, reward, done, infos = self.inner.step_wait()
        for row in np.flatnonzero(done) if self._bootstrap else ():
            failures, limit = infos[row]["failures"], self.inner.world.config.max_failures
            infos[row]["TimeLimit.truncated"] |= failures > limit
        return observation, reward, done, infos


class _Clock(BaseCallback):
    """Ends a training after some CPU seconds; `left` is the remaining fraction of them, 0-1."""

    def __init__(self, seconds: float) -> None:
        super().__init__()
        self._seconds, self._start = seconds, time.process_time()

    @property
    def left(self) -> float:
        return max(1.0 - (time.process_time() - self._start) / self._seconds, 0.0)

    def _on_step(self) -> bool:
        return self.left > 0.0


def _trained(env: _Squashed, seconds: float, seed: int) -> tuple[Network, int]:
    """Return the policy of a training of so many CPU seconds, and the number of control steps."""
    env.reset()
    env.step(np.zeros((env.num_envs, env.inner.world.action_size)))  # compiles the kernels
    clock = _Clock(seconds)
    model = PPO(
        "MlpPolicy", env, learning_rate=lambda _: 2e-3 * clock.left, n_steps=32, batch_size=2048,
        n_epochs=4, gamma=0.98, seed=seed, device="cpu",
        policy_kwargs={"net_arch": [128, 128], "activation_fn": nn.ReLU, "log_std_init": -1.0},
    )  # fmt: skip
    with without_denormals():
        model.learn(10**12, callback=clock)
    policy = model.policy
    layers = [*linear_layers(policy.mlp_extractor.policy_net), *linear_layers(policy.action_net)]
    weights = tuple(layer.weight.detach().numpy().T.copy() for layer in layers)
    biases = tuple(layer.bias.detach().numpy().copy() for layer in layers)
    inner = env.inner
    network = Network(inner.scale, weights, biases, inner.observation_terms)
    return network, model.num_timesteps * inner.batch.action_repeat


if __name__ == "__main__":
    main()
