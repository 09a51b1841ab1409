"""SAC of Stable-Baselines3 with cheaper updates, and an anchor for fine-tuning."""

from copy import deepcopy

import numpy as np
import torch
from stable_baselines3 import SAC
from stable_baselines3.common.utils import polyak_update
from torch import nn
from torch.nn import functional


class AnchoredSAC(SAC):
    """SAC that may be held near the policy that it starts from.

    The same to the bit as SAC without an anchor. Critics get no gradients while the actor learns,
    and a frozen actor is not updated.

    Attributes:
        anchor_weight: Factor on the squared difference between the mean actions, before the bounds,
            of the actor and of the policy that `anchor` kept, summed over the action terms.
    """

    anchor_weight = 0.0

    def anchor(self, weight: float) -> None:
        """Hold the actor near what it is now."""
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
                values = torch.cat(self.critic_target(data.next_observations, next_actions), dim=1)
                values = values.min(dim=1, keepdim=True)[0] - ent_coef * next_log_prob.reshape(
                    -1, 1
                )
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
                value = torch.cat(self.critic(data.observations, actions), dim=1)
                value = value.min(dim=1, keepdim=True)[0]
                actor_loss = (ent_coef * log_prob - value).mean() + self._distance(
                    data.observations
                )
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
