"""SAC and TD3 of Stable-Baselines3, and the networks that they learn."""

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import deepcopy
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import SAC, TD3
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.type_aliases import ReplayBufferSamples
from stable_baselines3.sac.policies import LOG_STD_MAX, LOG_STD_MIN
from torch import nn

from kinfeas.core.errors import KinfeasError
from kinfeas.policies.network import Network, write_network
from kinfeas.training.config import LearnerConfig
from kinfeas.training.vec_env import EpisodesVecEnv

Learner = SAC | TD3

_TINY, _HALF_LOG_TURN = 1e-6, 0.5 * math.log(2.0 * math.pi)

_ACTIVATIONS = ("torch.nn.modules.activation",)

INITIAL_STD = 0.1
"""Standard deviation, before the bounds, of SAC's actions when it starts from a policy."""


class DivergedError(KinfeasError):
    """Losses or weights of a learner are no longer finite."""


class Replay(ReplayBuffer):
    """A replay buffer with one row of numbers for each transition, so that a batch is one gather.

    The arrays of the base class are views of `rows`, shape (size, environments, numbers).
    """

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        observation, action = self.observations.shape[2], self.actions.shape[2]
        widths = (observation, observation, action, 1, 1, 1)
        self.rows = np.zeros((self.buffer_size, self.n_envs, sum(widths)), dtype=np.float32)
        parts = np.split(self.rows, np.cumsum(widths)[:-1], axis=2)
        self.observations, self.next_observations, self.actions = parts[:3]
        self.rewards, self.dones, self.timeouts = (part[:, :, 0] for part in parts[3:])
        self._flat = torch.from_numpy(self.rows).view(-1, sum(widths))
        self._widths = widths

    def sample(self, batch_size: int, env: object = None) -> ReplayBufferSamples:
        """Return random transitions; the end of an episode by its time limit is not terminal."""
        chosen = torch.randint(self.size() * self.n_envs, (batch_size,))
        parts = self._flat.index_select(0, chosen).split(self._widths, dim=1)
        seen, after, action, reward, done, timeout = parts
        return ReplayBufferSamples(seen, action, after, done * (1.0 - timeout), reward)


class Perceptrons:
    """k perceptrons of equal shape with ReLU between their layers, and their gradients.

    Torch's autograd takes twice the time for networks of this size. All parameters are one vector,
    updated in one call; those of the torch modules become views of it. All products have the type
    `dtype`, except those that lead to the outputs, which are float32.

    Args:
        networks: The layers of each perceptron; the outputs of the modules of a layer are joined.
    """

    def __init__(
        self, networks: Sequence[Sequence[Sequence[nn.Linear]]], dtype: torch.dtype
    ) -> None:
        self._shapes = [
            (len(networks), sum(one.out_features for one in layer), layer[0].in_features)
            for layer in networks[0]
        ]
        size = sum(k * outputs * (inputs + 1) for k, outputs, inputs in self._shapes)
        self.vector = nn.Parameter(torch.empty(size))
        self.vector.grad = torch.zeros(size)
        self._exact, self._gradient = map(self._views, (self.vector.data, self.vector.grad))
        self._rounded = self.vector.data if dtype == torch.float32 else torch.empty(size).to(dtype)
        self._fast = self._views(self._rounded)
        for number, network in enumerate(networks):
            for layer, (weight, bias) in zip(network, self._exact, strict=True):
                widths = [one.out_features for one in layer]
                parts = weight[number].split(widths), bias[number, 0].split(widths)
                for one, rows, shift in zip(layer, *parts, strict=True):
                    rows.copy_(one.weight.data)
                    shift.copy_(one.bias.data)
                    one.weight.data, one.bias.data = rows, shift

    def round(self) -> None:
        """Note that the parameters have changed."""
        self._rounded.copy_(self.vector.data)

    def forward(self, inputs: torch.Tensor) -> list[torch.Tensor]:
        """Return the inputs, shape (b, d), and the output of each layer, shape (k, b, width)."""
        values = [inputs.to(self._rounded.dtype).expand(self._shapes[0][0], *inputs.shape)]
        for weight, bias in self._fast[:-1]:
            values.append(torch.relu_(torch.baddbmm(bias, values[-1], weight.mT)))
        weight, bias = self._exact[-1]
        values.append(torch.baddbmm(bias, values[-1].to(weight.dtype), weight.mT))
        return values

    def backward(
        self, values: list[torch.Tensor], slope: torch.Tensor, columns: int = 0
    ) -> torch.Tensor | None:
        """Set the gradient of the parameters, or return that of the last `columns` inputs.

        `slope` is the gradient of the outputs, shape (k, b, outputs), `values` come from `forward`.
        """
        slope = slope.to(self._rounded.dtype)
        for i in reversed(range(len(self._shapes))):
            weight = self._fast[i][0]
            if not columns:
                change, shift = self._gradient[i]
                change.copy_(torch.bmm(slope.mT, values[i]))
                torch.sum(slope, 1, keepdim=True, dtype=torch.float32, out=shift)
            if i > 0:
                slope = torch.bmm(slope, weight)
                slope = torch.ops.aten.threshold_backward(slope, values[i], 0)
            elif columns:
                return torch.bmm(slope, weight[:, :, -columns:]).float()
        return None

    def _views(self, vector: torch.Tensor) -> list[tuple[torch.Tensor, torch.Tensor]]:
        """Return weight, shape (k, outputs, inputs), and bias, (k, 1, outputs), of each layer."""
        views, start = [], 0
        for k, outputs, inputs in self._shapes:
            middle, end = start + k * outputs * inputs, start + k * outputs * (inputs + 1)
            weight = vector[start:middle].view(k, outputs, inputs)
            views.append((weight, vector[middle:end].view(k, 1, outputs)))
            start = end
        return views


class FastSAC(SAC):
    """SAC with cheaper updates of `MlpPolicy`, optionally held near the policy it starts from.

    Attributes:
        policy_delay: Updates of the critics for each update of the actor.
        anchor_weight: Factor on the squared difference between the mean actions of the actor and
            of the policy that `anchor` kept, summed over the action terms.
    """

    policy_delay = 1
    anchor_weight = 0.0

    def _setup_model(self) -> None:
        super()._setup_model()
        self.use(product_type())

    def use(self, dtype: torch.dtype) -> None:
        """Use another type for products of matrices; resets the optimizers."""
        trunk: list[Sequence[nn.Linear]] = [[one] for one in _linear(self.actor.latent_pi)]
        heads: Any = [self.actor.mu, self.actor.log_std]
        self._actor = Perceptrons([[*trunk, heads]], dtype)
        self._critic, self._target = (
            Perceptrons([[[one] for one in _linear(q)] for q in critic.q_networks], dtype)
            for critic in (self.critic, self.critic_target)
        )
        for model, ours in ((self.actor, self._actor), (self.critic, self._critic)):
            model.optimizer = torch.optim.Adam(
                [ours.vector], lr=self.lr_schedule(1.0), **(self.policy.optimizer_kwargs)
            )

    def anchor(self, weight: float) -> None:
        """Hold the actor near its current weights."""
        self.anchor_weight = weight
        self._start = deepcopy(nn.Sequential(self.actor.latent_pi, self.actor.mu))

    def train(self, gradient_steps: int, batch_size: int = 64) -> None:
        """Update the critics, and the actor unless its parameters are frozen."""
        optimizers = [self.actor.optimizer, self.critic.optimizer]
        if self.ent_coef_optimizer is not None:
            optimizers.append(self.ent_coef_optimizer)
        self._update_learning_rate(optimizers)
        frozen = not self.actor.mu.weight.requires_grad
        losses: dict[str, list[torch.Tensor]] = {"actor_loss": [], "critic_loss": []}
        assert self.replay_buffer is not None
        with torch.no_grad():
            for networks in (self._actor, self._critic, self._target):
                networks.round()
            for _ in range(gradient_steps):
                data = self.replay_buffer.sample(batch_size)
                learns = self._n_updates % self.policy_delay == 0
                drawn = self._draw(data.observations) if learns else None
                ent_coef = self._entropy_coefficient(None if drawn is None else drawn.log_prob)
                losses["critic_loss"].append(self._update_critics(data, ent_coef))
                if drawn is not None and not frozen:
                    loss = self._update_actor(data.observations, drawn, ent_coef)
                    losses["actor_loss"].append(loss)
                self._target.vector.lerp_(self._critic.vector, self.tau)
                self._target.round()
                self._n_updates += 1
        self.logger.record("train/ent_coef", float(ent_coef))
        for name, values in losses.items():
            if values:
                self.logger.record(f"train/{name}", float(torch.stack(values).mean()))

    def draw(self, observations: torch.Tensor) -> torch.Tensor:
        """Return actions of the stochastic policy, shape (b, a)."""
        self._actor.round()
        return self._draw(observations).action

    def finite(self) -> bool:
        """Return whether all weights that learn are finite."""
        return bool(torch.isfinite(self._actor.vector.sum() + self._critic.vector.sum()))

    def _draw(self, observations: torch.Tensor) -> "_Drawn":
        layers = self._actor.forward(observations)
        mean, free = layers[-1][0].chunk(2, dim=1)
        log_std = free.clamp(LOG_STD_MIN, LOG_STD_MAX)
        noise = torch.randn_like(mean)
        action = torch.tanh(mean + log_std.exp() * noise)
        log_prob = -0.5 * noise.square() - log_std - _HALF_LOG_TURN
        log_prob = log_prob - torch.log(1.0 - action.square() + _TINY)
        return _Drawn(layers, noise, action, log_prob.sum(dim=1, keepdim=True))

    def _update_critics(self, data: ReplayBufferSamples, ent_coef: torch.Tensor) -> torch.Tensor:
        after = self._draw(data.next_observations)
        values = self._target.forward(torch.cat([data.next_observations, after.action], dim=1))[-1]
        value = values.amin(dim=0) - ent_coef * after.log_prob
        target = data.rewards + (1.0 - data.dones) * self.gamma * value
        layers = self._critic.forward(torch.cat([data.observations, data.actions], dim=1))
        error = layers[-1] - target
        self._critic.backward(layers, error / len(target))
        self.critic.optimizer.step()
        self._critic.round()
        return 0.5 * error.square().mean(dim=1).sum()

    def _update_actor(
        self, observations: torch.Tensor, drawn: "_Drawn", ent_coef: torch.Tensor
    ) -> torch.Tensor:
        action, n = drawn.action, len(observations)
        layers = self._critic.forward(torch.cat([observations, action], dim=1))
        value, lowest = layers[-1].min(dim=0, keepdim=True)
        share = torch.zeros_like(layers[-1]).scatter_(0, lowest, -1.0 / n)
        toward = self._critic.backward(layers, share, columns=action.shape[1])
        assert toward is not None
        bend = 1.0 - action.square()
        by_mean = bend * (toward.sum(dim=0) + 2.0 * ent_coef / n * action / (bend + _TINY))
        mean, free = drawn.layers[-1][0].chunk(2, dim=1)
        by_log_std = by_mean * free.exp() * drawn.noise - ent_coef / n
        loss = (ent_coef * drawn.log_prob - value[0]).mean()
        if self.anchor_weight:
            off = torch.tanh(mean) - torch.tanh(self._start(observations))
            loss = loss + self.anchor_weight * off.square().sum(1).mean()
            by_mean += 2.0 * self.anchor_weight / n * off * (1.0 - torch.tanh(mean).square())
        by_log_std[(free < LOG_STD_MIN) | (free > LOG_STD_MAX)] = 0.0
        self._actor.backward(drawn.layers, torch.cat([by_mean, by_log_std], dim=1).unsqueeze(0))
        self.actor.optimizer.step()
        self._actor.round()
        return loss

    def _entropy_coefficient(self, log_prob: torch.Tensor | None) -> torch.Tensor:
        """Return the coefficient; a learned one takes a step first, if there are actions."""
        if self.ent_coef_optimizer is None or self.log_ent_coef is None:
            return self.ent_coef_tensor
        coefficient = torch.exp(self.log_ent_coef.detach())
        if log_prob is not None:
            assert isinstance(self.target_entropy, float)
            # The derivative of -log_ent_coef * mean(log_prob + target_entropy).
            self.log_ent_coef.grad = -(log_prob + self.target_entropy).mean().view(1)
            self.ent_coef_optimizer.step()
        return coefficient


class _Drawn(NamedTuple):
    """Actions drawn from a policy, and what their gradient needs."""

    layers: list[torch.Tensor]
    noise: torch.Tensor
    action: torch.Tensor
    log_prob: torch.Tensor


def product_type() -> torch.dtype:
    """Return bfloat16 where the processor multiplies it twice as fast as float32."""
    return torch.bfloat16 if torch.cpu._is_avx512_bf16_supported() else torch.float32


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
        "replay_buffer_class": Replay,
        "seed": seed,
        "device": "cpu",
    }
    if config.algorithm == "td3":
        learner: Learner = TD3(**common, target_policy_noise=config.policy_noise)
    else:
        learner = FastSAC(
            **common, ent_coef="auto" if config.ent_coef == "learned" else config.ent_coef
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
        if isinstance(learner, FastSAC):
            return learner.draw(seen).numpy()
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
    """Raise DivergedError if a loss of the learner is not finite."""
    if not all(map(math.isfinite, losses.values())):
        raise _divergence(config)


def _divergence(config: LearnerConfig) -> DivergedError:
    rate = config.learning_rate
    return DivergedError(f"learning diverged: learner.learning_rate is {rate:g}, try a lower one")


def _diverged(learner: Learner) -> bool:
    if isinstance(learner, FastSAC):
        return not learner.finite()
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
    if isinstance(learner, FastSAC):
        learner.anchor(anchor)


def _layers(learner: Learner) -> list[nn.Linear]:
    """Return the layers that lead to the deterministic action, in order."""
    if isinstance(learner, TD3):
        return _linear(learner.actor.mu)
    return [*_linear(learner.actor.latent_pi), *_linear(learner.actor.mu)]


def _linear(module: nn.Module) -> list[nn.Linear]:
    return [one for one in module.modules() if isinstance(one, nn.Linear)]
