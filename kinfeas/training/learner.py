"""SAC and TD3 of Stable-Baselines3, and the networks that they learn."""

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import SAC, TD3
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.utils import polyak_update
from torch import nn
from torch.nn import functional

from kinfeas.core.errors import KinfeasError
from kinfeas.policies.network import Network, write_network
from kinfeas.training.config import LearnerConfig
from kinfeas.training.vec_env import EpisodesVecEnv

Learner = SAC | TD3

_ACTIVATIONS = ("torch.nn.modules.activation",)

INITIAL_STD = 0.1
"""Standard deviation, before the bounds, of SAC's actions when it starts from a policy."""


class AnchoredSAC(SAC):
    """SAC with cheaper updates, optionally held near the policy that it starts from.

    Without an anchor it equals SAC to the bit. Critics get no gradients while the actor learns,
    and a frozen actor is not updated.

    Attributes:
        anchor_weight: Factor on the squared difference between the mean actions of the actor and
            of the policy that `anchor` kept, summed over the action terms.
    """

    anchor_weight = 0.0

    def anchor(self, weight: float) -> None:
        """Hold the actor near its current weights."""
        self.anchor_weight = weight
        self._start = deepcopy(nn.Sequential(self.actor.latent_pi, self.actor.mu))

    def train(self, gradient_steps: int, batch_size: int = 64) -> None:
        """Update critics and actor, as `SAC.train` does."""
        self.policy.set_training_mode(True)
        optimizers = [self.actor.optimizer, self.critic.optimizer]
        if self.ent_coef_optimizer is not None:
            optimizers.append(self.ent_coef_optimizer)
        self._update_learning_rate(optimizers)
        frozen = not next(self.actor.parameters()).requires_grad
        losses: dict[str, list[float]] = {"actor_loss": [], "critic_loss": [], "ent_coef": []}
        assert self.replay_buffer is not None
        for _ in range(gradient_steps):
            data = self.replay_buffer.sample(batch_size)
            actions, log_prob = self.actor.action_log_prob(data.observations)
            log_prob = log_prob.reshape(-1, 1)
            ent_coef = self._entropy_coefficient(log_prob)
            losses["ent_coef"].append(ent_coef.item())
            with torch.no_grad():
                next_actions, next_log_prob = self.actor.action_log_prob(data.next_observations)
                values = _lowest(self.critic_target(data.next_observations, next_actions))
                values = values - ent_coef * next_log_prob.reshape(-1, 1)
                target = data.rewards + (1 - data.dones) * self.gamma * values
            found = self.critic(data.observations, data.actions)
            critic_loss = 0.5 * sum(functional.mse_loss(one, target) for one in found)
            assert isinstance(critic_loss, torch.Tensor)
            self.critic.optimizer.zero_grad()
            critic_loss.backward()
            self.critic.optimizer.step()
            losses["critic_loss"].append(critic_loss.item())
            if not frozen:
                self.critic.requires_grad_(False)
                value = _lowest(self.critic(data.observations, actions))
                actor_loss = (ent_coef * log_prob - value).mean()
                actor_loss = actor_loss + self._distance(data.observations)
                self.actor.optimizer.zero_grad()
                actor_loss.backward()
                self.actor.optimizer.step()
                self.critic.requires_grad_(True)
                losses["actor_loss"].append(actor_loss.item())
            polyak_update(self.critic.parameters(), self.critic_target.parameters(), self.tau)
        self._n_updates += gradient_steps
        for name, values_of in losses.items():
            if values_of:
                self.logger.record(f"train/{name}", np.mean(values_of))

    def _entropy_coefficient(self, log_prob: torch.Tensor) -> torch.Tensor:
        """Return the coefficient; a learned one takes a step first."""
        if self.ent_coef_optimizer is None or self.log_ent_coef is None:
            return self.ent_coef_tensor
        coefficient = torch.exp(self.log_ent_coef.detach())
        assert isinstance(self.target_entropy, float)
        loss = -(self.log_ent_coef * (log_prob + self.target_entropy).detach()).mean()
        self.ent_coef_optimizer.zero_grad()
        loss.backward()
        self.ent_coef_optimizer.step()
        return coefficient

    def _distance(self, observations: torch.Tensor) -> torch.Tensor | float:
        if self.anchor_weight == 0.0:
            return 0.0
        mean = self.actor.get_action_dist_params(observations)[0]
        with torch.no_grad():
            start = self._start(observations)
        return self.anchor_weight * (torch.tanh(mean) - torch.tanh(start)).square().sum(1).mean()


def _lowest(values: tuple[torch.Tensor, ...]) -> torch.Tensor:
    return torch.cat(values, dim=1).min(dim=1, keepdim=True)[0]


def make_learner(config: LearnerConfig, env: EpisodesVecEnv, seed: int) -> Learner:
    """Return a fresh learner whose random numbers are seeded."""
    # Small networks gain nothing from a second thread, and threads that wait for each other lose
    # most of their time as soon as another process wants a core.
    torch.set_num_threads(1)
    rate, linear = config.learning_rate, config.schedule == "linear"
    common: dict[str, Any] = {
        "policy": "MlpPolicy",
        "env": env,
        "learning_rate": (lambda remaining: rate * remaining) if linear else rate,
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
    """Round denormal numbers to 0 within the block, in this thread: optimizers are slow with them.

    The processor does so for all code of the thread, hence not permanently.
    """
    torch.set_flush_denormal(True)
    try:
        yield
    finally:
        torch.set_flush_denormal(False)


def explore(
    learner: Learner, config: LearnerConfig, observation: NDArray[np.float32], random: bool
) -> NDArray[np.float32]:
    """Return actions to learn from, shape (n, a), for scaled observations, shape (n, d).

    They are drawn with torch's generator; `random` ones are uniform, without the actor.
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


def learn(learner: Learner, config: LearnerConfig) -> None:
    """Take the gradient steps of one step of all environments."""
    try:
        learner.train(config.gradient_steps, config.batch_size)
    except ValueError:  # no distribution without finite weights
        if not _diverged(learner):
            raise
    if _diverged(learner):
        raise _divergence(config)


def check_losses(losses: Mapping[str, float], config: LearnerConfig) -> None:
    """Raise KinfeasError if a loss of the learner is not finite."""
    if not all(map(math.isfinite, losses.values())):
        raise _divergence(config)


def _divergence(config: LearnerConfig) -> KinfeasError:
    rate = config.learning_rate
    return KinfeasError(f"learning diverged: learner.learning_rate is {rate:g}, try a lower one")


def _diverged(learner: Learner) -> bool:
    weights = [*learner.actor.parameters(), *learner.critic.parameters()]
    return not bool(torch.isfinite(nn.utils.get_total_norm(weights)))


def network_of(learner: Learner, scale: NDArray[np.float32]) -> Network:
    """Return the learner's deterministic actor as a network that runs without torch."""
    linear = _layers(learner)
    return Network(
        scale,
        tuple(layer.weight.detach().numpy().T.copy() for layer in linear),
        tuple(layer.bias.detach().numpy().copy() for layer in linear),
    )


def save_policy(model: Learner, env: EpisodesVecEnv, folder: Path) -> None:
    """Write the policy of a Stable-Baselines3 model for `evaluate`, `export` and `deploy`.

    Args:
        model: SAC or TD3 with `MlpPolicy` and ReLU layers.
        env: Environment of its training, which determines robot and observation scale.
        folder: Existing folder for `policy.json` and `policy.safetensors`.

    Raises:
        KinfeasError: If the actor has other layers.
    """
    others = {type(m).__name__ for m in model.actor.modules() if type(m).__module__ in _ACTIVATIONS}
    if not others <= {"ReLU", "Tanh"} or (isinstance(model, SAC) and "Tanh" in others):
        raise KinfeasError(f"the actor must have ReLU layers, not {', '.join(sorted(others))}")
    write_network(network_of(model, env.scale), folder, env.robot, {"steps": model.num_timesteps})


def take_network(learner: Learner, network: Network, anchor: float = 0.0) -> None:
    """Copy a network into a fresh learner's actor, whose hidden layers are as wide.

    SAC's actions get the deviation `INITIAL_STD`; a positive `anchor` holds SAC near the network.
    """
    with torch.no_grad():
        for layer, weight, bias in zip(
            _layers(learner), network.weights, network.biases, strict=True
        ):
            layer.weight.copy_(torch.from_numpy(weight.T.copy()))
            layer.bias.copy_(torch.from_numpy(bias))
        if isinstance(learner, SAC):
            log_std: Any = learner.actor.log_std  # a layer, unlike its annotation
            log_std.weight.zero_()
            log_std.bias.fill_(math.log(INITIAL_STD))
        else:
            learner.actor_target.load_state_dict(learner.actor.state_dict())
    if isinstance(learner, AnchoredSAC):
        learner.anchor(anchor)


def _layers(learner: Learner) -> list[nn.Linear]:
    """Return the layers that lead to the deterministic action, in order."""
    actor = learner.actor
    # In SAC's actor the layers of the deviation follow those of the mean.
    used = [name for name, _ in actor.named_modules() if name.split(".")[0] in ("latent_pi", "mu")]
    return [m for m in map(actor.get_submodule, used) if isinstance(m, nn.Linear)]
