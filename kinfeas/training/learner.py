"""SAC of Stable-Baselines3 as a learner, and the networks that it learns."""

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import SAC
from stable_baselines3.common.logger import Logger
from torch import nn

from kinfeas.core.errors import KinfeasError
from kinfeas.policies.network import Network, write_network
from kinfeas.training.config import LearnerConfig
from kinfeas.training.fast_sac import FastReplayBuffer, FastSAC, linear_layers
from kinfeas.training.vec_env import EpisodesVecEnv

INITIAL_STD = 0.1
"""Standard deviation, before the bounds, of the actions when training starts from a policy."""


class DivergedError(KinfeasError):
    """Losses or weights of a learner are no longer finite."""


def make_learner(config: LearnerConfig, env: EpisodesVecEnv, seed: int) -> FastSAC:
    """Return a fresh learner whose random numbers are seeded."""
    # Small networks gain nothing from a second thread, and threads that wait for each other lose
    # most of their time as soon as another process wants a core.
    torch.set_num_threads(1)
    rate, linear = config.learning_rate, config.schedule == "linear"
    learner = FastSAC(
        policy="MlpPolicy",
        env=env,
        learning_rate=(lambda remaining: rate * remaining) if linear else rate,
        batch_size=config.batch_size,
        gradient_steps=config.gradient_steps,
        gamma=config.gamma,
        tau=config.tau,
        buffer_size=max(config.buffer_size, env.num_envs),
        learning_starts=config.learning_starts,
        policy_kwargs={"net_arch": list(config.net_arch), "optimizer_kwargs": {"fused": True}},
        replay_buffer_class=FastReplayBuffer,
        ent_coef="auto" if config.ent_coef == "learned" else config.ent_coef,
        seed=seed,
        device="cpu",
    )
    learner.policy_delay = config.policy_delay
    learner.set_logger(Logger(None, []))
    return learner


@contextmanager
def without_denormals() -> Iterator[None]:
    """Round denormal numbers to 0 within the block, in this thread: optimizers are slow with them.

    The processor does so for all code of the thread, hence not permanently.
    """
    torch.set_flush_denormal(True)
    try:
        yield
    finally:
        torch.set_flush_denormal(False)


def explore(
    learner: FastSAC, observation: NDArray[np.float32], *, random: bool
) -> NDArray[np.float32]:
    """Return actions to learn from, shape (n, a), for scaled observations, shape (n, d).

    They are drawn with torch's generator; `random` ones are uniform, without the actor.
    """
    if random:
        assert learner.action_space.shape is not None
        return (2.0 * torch.rand(len(observation), *learner.action_space.shape) - 1.0).numpy()
    with torch.no_grad():
        return learner.draw(torch.from_numpy(observation)).numpy()


def learn(learner: FastSAC, config: LearnerConfig) -> None:
    """Take the gradient steps of one step of all environments."""
    learner.train(config.gradient_steps, config.batch_size)
    if not learner.finite():
        raise _divergence(config)


def check_losses(losses: Mapping[str, float], config: LearnerConfig) -> None:
    """Raise DivergedError if a loss of the learner is not finite."""
    if not all(map(math.isfinite, losses.values())):
        raise _divergence(config)


def _divergence(config: LearnerConfig) -> DivergedError:
    rate = config.learning_rate
    return DivergedError(f"learning diverged: learner.learning_rate is {rate:g}, try a lower one")


def network_of(learner: SAC, env: EpisodesVecEnv) -> Network:
    """Return the learner's deterministic actor as a network that runs without torch."""
    weights = tuple(layer.weight.detach().numpy().T.copy() for layer in _layers(learner))
    biases = tuple(layer.bias.detach().numpy().copy() for layer in _layers(learner))
    return Network(env.scale, weights, biases, env.observation_terms)


def save_policy(model: SAC, env: EpisodesVecEnv, folder: Path) -> None:
    """Write the policy of a Stable-Baselines3 model for `evaluate`, `export` and `deploy`.

    The model is SAC or TQC, with `MlpPolicy` and ReLU layers; `env`, that of its training,
    determines robot and observation scale. `policy.json` and `policy.safetensors` are written into
    the existing folder.

    Raises:
        KinfeasError: If the model is of another algorithm, or the actor has other layers.
    """
    if not hasattr(getattr(model, "actor", None), "latent_pi"):
        raise KinfeasError(f"the algorithm must be SAC or TQC, not {type(model).__name__}")
    hidden: Any = model.actor.latent_pi
    layers = [*hidden, model.actor.features_extractor]
    if others := {type(m).__name__ for m in layers} - {"Linear", "ReLU", "FlattenExtractor"}:
        raise KinfeasError(f"the actor must have ReLU layers, not {', '.join(sorted(others))}")
    write_network(network_of(model, env), folder, env.robot, {"steps": model.num_timesteps})


def take_network(
    learner: FastSAC, network: Network, anchor: float = 0.0, surroundings: Sequence[int] = ()
) -> None:
    """Copy a network into a fresh learner's actor, whose hidden layers are as wide.

    Its actions get the deviation `INITIAL_STD`. A positive `anchor` holds it near the network
    where all the inputs `surroundings` that the network ignores are 0.
    """
    with torch.no_grad():
        for layer, weight, bias in zip(
            _layers(learner), network.weights, network.biases, strict=True
        ):
            layer.weight.copy_(torch.from_numpy(weight.T.copy()))
            layer.bias.copy_(torch.from_numpy(bias))
        log_std: Any = learner.actor.log_std  # a layer, unlike its annotation
        log_std.weight.zero_()
        log_std.bias.fill_(math.log(INITIAL_STD))
    ignored = [number for number in surroundings if not network.weights[0][number].any()]
    learner.anchor(anchor, ignored)


def _layers(learner: SAC) -> list[nn.Linear]:
    """Return the layers that lead to the deterministic action, in order."""
    return [*linear_layers(learner.actor.latent_pi), *linear_layers(learner.actor.mu)]
