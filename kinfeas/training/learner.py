"""SAC and TD3 of Stable-Baselines3, as the configuration asks for them."""

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import SAC, TD3
from stable_baselines3.common.logger import Logger
from torch import nn

from kinfeas.core.errors import KinfeasError
from kinfeas.policies.network import Network
from kinfeas.training.config import LearnerConfig
from kinfeas.training.sac import AnchoredSAC
from kinfeas.training.vec_env import EpisodesVecEnv

Learner = SAC | TD3

DEVIATION = 0.1
"""Standard deviation, before the bounds, of SAC's actions as it goes on from a policy."""


def make_learner(config: LearnerConfig, env: EpisodesVecEnv, seed: int) -> Learner:
    """Return a fresh learner whose random numbers are seeded."""
    # Small networks gain nothing from a second thread, and threads that wait for each other lose
    # most of their time as soon as another process wants a core.
    torch.set_num_threads(1)
    common: dict[str, Any] = {
        "policy": "MlpPolicy",
        "env": env,
        "learning_rate": _schedule(config),
        "batch_size": config.batch_size,
        "gradient_steps": config.gradient_steps,
        "gamma": config.gamma,
        "tau": config.tau,
        "buffer_size": max(config.buffer_size, env.num_envs),
        "learning_starts": config.learning_starts,
        "policy_kwargs": {
            "net_arch": list(config.net_arch),
            "optimizer_kwargs": {"fused": True},
        },
        "seed": seed,
        "device": "cpu",
    }
    if config.algorithm == "td3":
        learner: Learner = TD3(**common, target_policy_noise=config.policy_noise)
    else:
        learner = AnchoredSAC(
            **common, ent_coef="auto" if config.ent_coef == "learned" else config.ent_coef
        )
    learner.set_logger(Logger(None, []))
    return learner


@contextmanager
def without_denormals() -> Iterator[None]:
    """Round the tiniest numbers to 0 within the block, for optimizers are slow with them.

    The processor does so for everything that runs in the thread, hence not for good.
    """
    torch.set_flush_denormal(True)
    try:
        yield
    finally:
        torch.set_flush_denormal(False)


def explore(
    learner: Learner, config: LearnerConfig, observation: NDArray[np.float32], random: bool
) -> NDArray[np.float32]:
    """Return actions to learn from, shape (n, a); all chance comes from torch's generator.

    Args:
        learner: Whose actor acts.
        config: TD3's exploration noise.
        observation: Scaled observations, shape (n, d).
        random: Whether to ignore the actor.
    """
    if random:
        assert learner.action_space.shape is not None
        return (2.0 * torch.rand(len(observation), *learner.action_space.shape) - 1.0).numpy()
    with torch.no_grad():
        seen = torch.from_numpy(observation)
        if isinstance(learner, SAC):
            return learner.actor(seen, deterministic=False).numpy()
        action = learner.actor(seen)
        action = action + config.exploration_noise * torch.randn_like(action)
        return action.clamp(-1.0, 1.0).numpy()


def network_of(learner: Learner, scale: NDArray[np.float32]) -> Network:
    """Return the learner's deterministic actor as a network that runs without torch."""
    linear = _layers(learner)
    return Network(
        scale,
        tuple(layer.weight.detach().numpy().T.copy() for layer in linear),
        tuple(layer.bias.detach().numpy().copy() for layer in linear),
    )


def learn(learner: Learner, config: LearnerConfig) -> None:
    """Take the gradient steps that belong to one step of all environments.

    Raises:
        KinfeasError: If a weight is no finite number any more.
    """
    try:
        learner.train(config.gradient_steps, config.batch_size)
    except ValueError:  # where a weight is no number, chance has no distribution
        if not _diverged(learner):
            raise
    if _diverged(learner):
        raise _divergence(config)


def check_losses(losses: Mapping[str, float], config: LearnerConfig) -> None:
    """Check that what was logged of the learner is finite.

    Raises:
        KinfeasError: If it is not.
    """
    if not all(map(math.isfinite, losses.values())):
        raise _divergence(config)


def take_network(learner: Learner, network: Network, anchor: float = 0.0) -> None:
    """Let a fresh learner's actor act as a network does; SAC's with the deviation `DEVIATION`.

    Args:
        learner: Its hidden layers must be as wide as the network's.
        network: Whose weights it takes.
        anchor: How strongly SAC is held near it; 0 for not at all.
    """
    with torch.no_grad():
        for layer, weight, bias in zip(
            _layers(learner), network.weights, network.biases, strict=True
        ):
            layer.weight.copy_(torch.from_numpy(weight.T.copy()))
            layer.bias.copy_(torch.from_numpy(bias))
        if isinstance(learner, SAC):
            spread: Any = learner.actor.log_std  # a layer, whatever its type says
            spread.weight.zero_()
            spread.bias.fill_(math.log(DEVIATION))
        else:
            learner.actor_target.load_state_dict(learner.actor.state_dict())
    if isinstance(learner, AnchoredSAC):
        learner.anchor(anchor)


def _divergence(config: LearnerConfig) -> KinfeasError:
    rate = config.learning_rate
    return KinfeasError(f"learning diverged: learner.learning_rate is {rate:g}, try a lower one")


def _diverged(learner: Learner) -> bool:
    weights = [*learner.actor.parameters(), *learner.critic.parameters()]
    return not bool(torch.isfinite(nn.utils.get_total_norm(weights)))


def _layers(learner: Learner) -> list[nn.Linear]:
    """Return the layers that lead to the deterministic action, in order."""
    actor = learner.actor
    # In SAC's actor the layers of the deviation follow those of the mean.
    used = [name for name, _ in actor.named_modules() if name.split(".")[0] in ("latent_pi", "mu")]
    return [m for m in map(actor.get_submodule, used) if isinstance(m, nn.Linear)]


def _schedule(config: LearnerConfig) -> Any:
    if config.schedule == "constant":
        return config.learning_rate
    return _Falling(config.learning_rate)


class _Falling:
    """A learning rate proportional to what remains of the run."""

    def __init__(self, start: float) -> None:
        self.start = start

    def __call__(self, remaining: float) -> float:
        return self.start * remaining
