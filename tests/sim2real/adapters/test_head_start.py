import numpy as np
import pytest

from kinfeas.backends.analytic import AnalyticBackend
from kinfeas.config import PluginSpec
from kinfeas.control.adapters import wrap
from kinfeas.control.execution import ExecutionAdapter, ExecutionConfig
from kinfeas.core.backend import Resumable
from kinfeas.core.errors import KinfeasError
from kinfeas.envs.world import World, WorldConfig
from kinfeas.sim2real.adapters.head_start import HeadStart
from kinfeas.tasks.ggr import ggr


def test_head_starts_add_up(pr2):
    one = HeadStart(AnalyticBackend(), pr2, seconds=2.0)
    two = HeadStart(one, pr2, seconds=[0.5, 1.5])
    assert isinstance(two, ExecutionAdapter)
    assert isinstance(two, Resumable)
    assert two.execution(one.execution(ExecutionConfig(head_start=1.0))) == ExecutionConfig(
        head_start=3.5, head_start_jitter=1.0
    )


def stands(robot, seconds, episodes, dt=0.1):
    """Return for how many periods the EE of each episode stands still."""
    config = WorldConfig(dt=dt, adapters=(PluginSpec("head_start", {"seconds": seconds}),))
    world = World(robot, ggr(), config, seed=0)
    world.start(episodes)
    first, still = world.loop.desired, np.zeros(len(episodes), dtype=int)
    for _ in range(30):
        world.step(np.zeros((len(episodes), world.action_size)))
        still += np.all(world.loop.desired == first, axis=1)
    return still.tolist()


@pytest.mark.parametrize("dt", [0.1, 0.05])
def test_the_ee_stands_for_as_long(pr2, dt):
    assert stands(pr2, 0.5, range(3), dt) == [round(0.5 / dt)] * 3


def test_each_episode_draws_its_own(pr2):
    together = stands(pr2, [0.0, 2.0], range(6))
    assert len(set(together)) > 3
    assert max(together) <= 20
    assert stands(pr2, [0.0, 2.0], [4]) == [together[4]]


def test_a_time_is_not_negative(pr2):
    with pytest.raises(KinfeasError, match="seconds is -1, must be"):
        wrap(AnalyticBackend(), [PluginSpec("head_start", {"seconds": -1})], pr2)
