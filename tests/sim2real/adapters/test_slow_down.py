import numpy as np
import pytest

from kinfeas.backends.analytic import AnalyticBackend
from kinfeas.config import PluginSpec
from kinfeas.control.adapters import execution_of, wrap
from kinfeas.control.execution import ExecutionConfig
from kinfeas.core.errors import KinfeasError
from kinfeas.envs.world import World, WorldConfig
from kinfeas.tasks.ggr import ggr

SLOW = PluginSpec("slow_down", {"factor": 2.0})


def test_factors_multiply(pr2):
    backend = wrap(AnalyticBackend(), [SLOW, PluginSpec("base_noise"), SLOW], pr2)
    assert execution_of(backend, ExecutionConfig(slow_down=1.5)) == ExecutionConfig(slow_down=6.0)


def test_motions_take_as_much_longer_and_have_as_much_more_time(pr2):
    slow = World(pr2, ggr(), WorldConfig(max_seconds=2.0, adapters=(SLOW,)), seed=0)
    plain = World(pr2, ggr(), WorldConfig(max_seconds=2.0), seed=0)
    for world in (slow, plain):
        world.start([0])
    ways = []
    for world, steps in ((slow, 40), (plain, 20)):
        on_reset = world.loop.desired[:, :3]
        for step in range(steps):
            done = world.step(np.zeros((1, 3))).truncated[0]
            assert done == (step == steps - 1)
        ways.append(np.linalg.norm(world.loop.desired[:, :3] - on_reset))
    assert ways[0] == pytest.approx(ways[1], rel=1e-3)


def test_all_factors_together_have_a_bound(pr2):
    backend = wrap(AnalyticBackend(), [PluginSpec("slow_down", {"factor": 100.0})] * 2, pr2)
    with pytest.raises(KinfeasError, match=r"slow_down must be a number in \[1, 1000\] in all"):
        execution_of(backend, ExecutionConfig())


@pytest.mark.parametrize(
    ("factor", "message"),
    [(0.5, r"in \[1, 1000\]"), (1e300, r"in \[1, 1000\]"), ([1.0, 2.0], "one number for all")],
)
def test_it_slows_down_by_one_number(pr2, factor, message):
    with pytest.raises(KinfeasError, match=message):
        wrap(AnalyticBackend(), [PluginSpec("slow_down", {"factor": factor})], pr2)
