"""SAC of Stable-Baselines3 with cheaper updates, and its replay buffer."""

import math
from collections.abc import Sequence
from copy import deepcopy
from typing import Any, NamedTuple

import numpy as np
import torch
from stable_baselines3 import SAC
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.policies import ContinuousCritic
from stable_baselines3.common.type_aliases import ReplayBufferSamples
from stable_baselines3.sac.policies import LOG_STD_MAX, LOG_STD_MIN
from torch import nn

_TINY, _HALF_LOG_2PI = 1e-6, 0.5 * math.log(2.0 * math.pi)


class FastReplayBuffer(ReplayBuffer):
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
        """Return random transitions; an episode that ends by its time limit is not terminal."""
        indices = torch.randint(self.size() * self.n_envs, (batch_size,))
        parts = self._flat.index_select(0, indices).split(self._widths, dim=1)
        observation, after, action, reward, done, timeout = parts
        return ReplayBufferSamples(observation, action, after, done * (1.0 - timeout), reward)


class Perceptrons:
    """k perceptrons of equal shape with ReLU between their layers, and their gradients.

    Torch's autograd takes twice the time for networks of this size. All parameters are one vector,
    updated in one call; those of the torch modules become views of it. All products have the type
    `dtype`, except those that lead to the outputs, which are float32.

    Args:
        networks: The layers of each perceptron, each of one or more modules that have the same
            inputs and whose outputs are concatenated.
    """

    def __init__(
        self, networks: Sequence[Sequence[Sequence[nn.Linear]]], dtype: torch.dtype
    ) -> None:
        self._shapes = [
            (len(networks), sum(module.out_features for module in layer), layer[0].in_features)
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
                widths = [module.out_features for module in layer]
                parts = weight[number].split(widths), bias[number, 0].split(widths)
                for module, rows, shift in zip(layer, *parts, strict=True):
                    rows.copy_(module.weight.data)
                    shift.copy_(module.bias.data)
                    module.weight.data, module.bias.data = rows, shift

    def refresh(self) -> None:
        """Update the copy of the parameters in the type `dtype` after these have changed."""
        self._rounded.copy_(self.vector.data)

    def forward(self, inputs: torch.Tensor) -> list[torch.Tensor]:
        """Return the inputs, (b, d), and the output of each layer, all as shape (k, b, width)."""
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
            of the policy that `anchor` kept, summed over the action.
    """

    policy_delay = 1
    anchor_weight = 0.0
    replay_buffer: FastReplayBuffer

    def _setup_model(self) -> None:
        super()._setup_model()
        self.use(product_type())

    def use(self, dtype: torch.dtype) -> None:
        """Compute matrix products in the type `dtype`; resets the optimizers."""
        trunk: list[Sequence[nn.Linear]] = [
            [module] for module in linear_layers(self.actor.latent_pi)
        ]
        heads: Any = [self.actor.mu, self.actor.log_std]
        self._actor = Perceptrons([[*trunk, heads]], dtype)

        def joined(critic: ContinuousCritic) -> Perceptrons:
            networks = [[[module] for module in linear_layers(q)] for q in critic.q_networks]
            return Perceptrons(networks, dtype)

        self._critic, self._target = joined(self.critic), joined(self.critic_target)
        for model, ours in ((self.actor, self._actor), (self.critic, self._critic)):
            model.optimizer = torch.optim.Adam(
                [ours.vector], lr=self.lr_schedule(1.0), **(self.policy.optimizer_kwargs)
            )

    def anchor(self, weight: float, zero: Sequence[int] = ()) -> None:
        """Hold the actor near its current actions where inputs with indices `zero` are all 0."""
        self.anchor_weight, self._zero = weight, torch.tensor(zero, dtype=torch.long)
        self._start = deepcopy(nn.Sequential(self.actor.latent_pi, self.actor.mu))

    def train(self, gradient_steps: int, batch_size: int = 64) -> None:
        """Update the critics, and the actor unless its parameters are frozen."""
        optimizers = [self.actor.optimizer, self.critic.optimizer]
        if self.ent_coef_optimizer is not None:
            optimizers.append(self.ent_coef_optimizer)
        self._update_learning_rate(optimizers)
        frozen = not self.actor.mu.weight.requires_grad
        losses: dict[str, list[torch.Tensor]] = {"actor_loss": [], "critic_loss": []}
        with torch.no_grad():
            for networks in (self._actor, self._critic, self._target):
                networks.refresh()
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
                self._target.refresh()
                self._n_updates += 1
        self.logger.record("train/ent_coef", float(ent_coef))
        for name, values in losses.items():
            if values:
                self.logger.record(f"train/{name}", float(torch.stack(values).mean()))

    def draw(self, observations: torch.Tensor) -> torch.Tensor:
        """Return actions of the stochastic policy, shape (b, a)."""
        self._actor.refresh()
        return self._draw(observations).action

    def finite(self) -> bool:
        """Return whether all weights that learn are finite."""
        return bool(torch.isfinite(self._actor.vector.sum() + self._critic.vector.sum()))

    def _draw(self, observations: torch.Tensor) -> "_Drawn":
        layers = self._actor.forward(observations)
        mean, raw_log_std = layers[-1][0].chunk(2, dim=1)
        log_std = raw_log_std.clamp(LOG_STD_MIN, LOG_STD_MAX)
        noise = torch.randn_like(mean)
        action = torch.tanh(mean + log_std.exp() * noise)
        log_prob = -0.5 * noise.square() - log_std - _HALF_LOG_2PI
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
        self._critic.refresh()
        return 0.5 * error.square().mean(dim=1).sum()

    def _update_actor(
        self, observations: torch.Tensor, drawn: "_Drawn", ent_coef: torch.Tensor
    ) -> torch.Tensor:
        action, n = drawn.action, len(observations)
        layers = self._critic.forward(torch.cat([observations, action], dim=1))
        value, lowest = layers[-1].min(dim=0, keepdim=True)
        weights = torch.zeros_like(layers[-1]).scatter_(0, lowest, -1.0 / n)
        by_action = self._critic.backward(layers, weights, columns=action.shape[1])
        assert by_action is not None
        dtanh = 1.0 - action.square()
        by_mean = dtanh * (by_action.sum(dim=0) + 2.0 * ent_coef / n * action / (dtanh + _TINY))
        mean, raw_log_std = drawn.layers[-1][0].chunk(2, dim=1)
        by_log_std = by_mean * raw_log_std.exp() * drawn.noise - ent_coef / n
        loss = (ent_coef * drawn.log_prob - value[0]).mean()
        if self.anchor_weight:
            anchored = (observations[:, self._zero] == 0.0).all(dim=1, keepdim=True)
            difference = anchored * (torch.tanh(mean) - torch.tanh(self._start(observations)))
            loss = loss + self.anchor_weight * difference.square().sum(1).mean()
            by_mean += 2.0 * self.anchor_weight / n * difference * (1.0 - torch.tanh(mean).square())
        by_log_std[(raw_log_std < LOG_STD_MIN) | (raw_log_std > LOG_STD_MAX)] = 0.0
        self._actor.backward(drawn.layers, torch.cat([by_mean, by_log_std], dim=1).unsqueeze(0))
        self.actor.optimizer.step()
        self._actor.refresh()
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
    """Actions drawn from a policy, and the values that their gradient needs."""

    layers: list[torch.Tensor]
    noise: torch.Tensor
    action: torch.Tensor
    log_prob: torch.Tensor


def product_type() -> torch.dtype:
    """Return bfloat16 where the processor multiplies it twice as fast as float32."""
    return torch.bfloat16 if torch.cpu._is_avx512_bf16_supported() else torch.float32


def linear_layers(module: nn.Module) -> list[nn.Linear]:
    """Return the linear layers of a module, in order."""
    return [layer for layer in module.modules() if isinstance(layer, nn.Linear)]
