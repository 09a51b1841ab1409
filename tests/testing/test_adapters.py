import numpy as np
import pytest

from kinfeas.config import PluginSpec, registry
from kinfeas.core.errors import KinfeasError
from kinfeas.robots.loading import load_robot
from kinfeas.sim2real.adapters.adapter import Adapter, measured
from kinfeas.testing import check_adapter


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


@pytest.mark.parametrize(("kind", "named"), [
    (NoEffect, "overrides no"), (InfiniteLater, "twist"), (Writes, "input"), (MeansRows, "row"),
    (OneClock, "row"), (OwnRandomness, "seed"), (Smooths, "reset"),
])  # fmt: skip
def test_each_rule_of_adapters_is_checked(monkeypatch, kind, named):
    monkeypatch.setattr(registry, "_REGISTERED", [])
    registry.register("kinfeas.adapters", "mine", kind)
    with pytest.raises(KinfeasError, match=f"adapter 'mine'.*{named}"):
        check_adapter(PluginSpec("mine"), load_robot("pr2"))


def test_misspelt_hooks_are_errors():
    with pytest.raises(KinfeasError, match=r"modify_comand.*modify_command"):
        type("Misspelt", (Adapter,), {"modify_comand": lambda self, *command: command})
