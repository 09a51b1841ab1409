import numpy as np
import pytest

from kinfeas.config import PluginSpec
from kinfeas.envs.world import World, WorldConfig
from kinfeas.tasks.ggr import ggr

SLOW = PluginSpec("time_scale", {"factor": 0.5})


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


@pytest.mark.parametrize("dt", [0.1, 0.05])
def test_the_ee_rests_for_the_head_start_of_its_episode(pr2, dt):
    config = WorldConfig(dt=dt, adapters=(PluginSpec("head_start", {"seconds": [0.5, 1.5]}),))
    world = World(pr2, ggr(), config, seed=0)
    world.start(range(3))
    first, still = world.loop.desired, np.zeros(3, dtype=int)
    for _ in range(30):
        world.step(np.zeros((3, world.action_size)))
        still += np.all(world.loop.desired == first, axis=1)
    assert len(set(still)) == 3
    assert np.all((still >= 0.5 / dt) & (still <= 1.5 / dt))
