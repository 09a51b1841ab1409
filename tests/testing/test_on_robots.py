import numpy as np
import pytest

from kinfeas.backends.analytic import AnalyticBackend
from kinfeas.config import PluginSpec, registry
from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import rotation
from kinfeas.robots.loading import load_robot
from kinfeas.sim2real.adapters.adapter import Adapter, measured
from kinfeas.testing import check_adapter, check_backend, check_filter


class NoEffect(Adapter):
    def turn_around(self):
        """A method that nothing calls."""


class InfiniteLater(Adapter):
    def on_reset(self, state):
        return {"time": np.zeros(len(state.base_pose))}

    def on_step(self, state, dt):
        self.remember(time=self.memory["time"] + dt)

    def modify_command(self, twist, targets, dt):
        with np.errstate(divide="ignore", invalid="ignore"):
            return twist / (self.memory["time"][:, np.newaxis] < 1.0), targets


class Writes(Adapter):
    def modify_command(self, twist, targets, dt):
        twist *= 0.5
        return twist, targets


class MeansRows(Adapter):
    def modify_command(self, twist, targets, dt):
        return twist - twist.mean(axis=0), targets


class OneClock(Adapter):
    """Starts its memory anew in all rows as soon as one of them is reset."""

    def on_reset(self, state):
        self.time = 0.0
        return {}

    def on_step(self, state, dt):
        self.time += dt

    def modify_command(self, twist, targets, dt):
        return twist * min(self.time, 1.0), targets


class Smooths(Adapter):
    """Keeps a mean of each row's commands, which no reset clears."""

    mean = 0.0

    def modify_command(self, twist, targets, dt):
        self.mean = 0.9 * self.mean + 0.1 * twist
        return self.mean.copy(), targets


class OwnRandomness(Adapter):
    rng = np.random.default_rng(0)

    def modify_state(self, state):
        noise = self.rng.normal(size=state.joint_positions.shape)
        return measured(state, joint_positions=state.joint_positions + noise)


def test_misspelt_hooks_are_errors():
    with pytest.raises(KinfeasError, match=r"modify_comand.*modify_command"):
        type("Misspelt", (Adapter,), {"modify_comand": lambda self, *command: command})


class BodyTwist(AnalyticBackend):
    """Takes the twist as if it were in the frame of the base."""

    def step(self, base_twist, joint_targets, dt):
        heading = rotation(self.state.base_pose)
        twist = np.hstack([heading.apply(part) for part in (base_twist[:, :3], base_twist[:, 3:])])
        return super().step(twist, joint_targets, dt)


class StaysThere(AnalyticBackend):
    def reset(self, base_pose, joint_positions, env_ids=None):
        return super().reset(base_pose * [0, 0, 1, 1, 1, 1, 1], joint_positions, env_ids)


class ArmOfAnother(AnalyticBackend):
    def step(self, base_twist, joint_targets, dt):
        return super().step(base_twist, np.roll(joint_targets, 1, axis=0), dt)


class ResetsAll(AnalyticBackend):
    def reset(self, base_pose, joint_positions, env_ids=None):
        if env_ids is None:
            self.first = base_pose, joint_positions
        else:
            super().reset(*self.first)
        return super().reset(base_pose, joint_positions, env_ids)


class Slack(AnalyticBackend):
    def step(self, base_twist, joint_targets, dt):
        return super().step(base_twist, joint_targets - 0.1, dt)


class Mean:
    def __call__(self, period):
        return period.commanded(0.5 * period.command + 0.5 * period.command.mean(axis=0))


class Remembers:
    """Smooths commands over the ends of episodes."""

    command = 0.0

    def __call__(self, period):
        self.command = 0.5 * self.command + 0.5 * period.command
        return period.commanded(self.command.copy())


class Shakes:
    rng = np.random.default_rng(0)

    def __call__(self, period):
        return period.commanded(0.9 * period.command * self.rng.uniform(size=period.command.shape))


class Infinite:
    def __call__(self, period):
        return period.commanded(np.full_like(period.command, np.inf))


@pytest.mark.parametrize(("check", "kind", "named"), [
    (check_adapter, NoEffect, "overrides no"), (check_adapter, InfiniteLater, "twist"),
    (check_adapter, Writes, "input"), (check_adapter, MeansRows, "row"),
    (check_adapter, OneClock, "row"), (check_adapter, OwnRandomness, "seed"),
    (check_adapter, Smooths, "reset"),
    (check_backend, BodyTwist, "twist"), (check_backend, StaysThere, "reset puts"),
    (check_backend, ArmOfAnother, "row depends"), (check_backend, ResetsAll, "row depends"),
    (check_backend, Slack, "arms"),
    (check_filter, Mean, "row depends"), (check_filter, Remembers, "reset begins"),
    (check_filter, Shakes, "repeats"), (check_filter, Infinite, "Infinite.*finite"),
])  # fmt: skip
def test_each_rule_is_checked(monkeypatch, check, kind, named):
    group = check.__name__.removeprefix("check_")
    monkeypatch.setattr(registry, "_REGISTERED", [])
    registry.register(f"kinfeas.{group}s", "mine", kind)
    with pytest.raises(KinfeasError, match=f"{group} .*{named}"):
        check(PluginSpec("mine"), load_robot("hsr"))
