from unittest.mock import Mock

import numpy as np
import pytest

from kinfeas.config import registry
from kinfeas.control.assemble import read_sim2real
from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import planar_pose
from kinfeas.envs.world import World, WorldConfig
from kinfeas.robots.loading import load_robot
from kinfeas.sim2real.adapters.dynamics import DomainRandomisation
from kinfeas.tasks.loading import load_task

DT, TICKS = 0.02, 40


@pytest.fixture(scope="module")
def world(engine):
    backend = registry.load("kinfeas.backends", engine)(load_robot("tiago"))
    yield backend
    backend.close()


def swing(world, factors, rows=None):
    """Return the arms after a swing, (n, j), with a row for each of the factors."""
    home = world.robot.home["home"]
    world.reset(planar_pose(*np.zeros((3, len(factors)))), np.tile(home, (len(factors), 1)))
    if rows is not None:
        world.scale_dynamics(*np.array(factors).T, rows)
    far = np.tile(home + 0.5 * np.sign(0.5 - home), (len(factors), 1))
    for _ in range(TICKS):
        state = world.step(np.zeros((len(factors), 6)), far, DT)
    return state.joint_positions


def test_masses_and_gains_change_the_motion_of_their_rows_alone(world):
    plain = swing(world, [(1.0, 1.0, 1.0)] * 3)
    np.testing.assert_array_equal(plain[1:], plain[:1].repeat(2, axis=0))
    varied = swing(world, [(1.0, 1.0, 1.0), (6.0, 1.0, 1.0), (1.0, 1.0, 0.2)], np.arange(3))
    np.testing.assert_allclose(varied[0], plain[0], atol=1e-9)
    assert np.abs(varied[1:] - plain[0]).max(axis=1).min() > 1e-3
    again = swing(world, [(1.0, 1.0, 1.0)] * 3, np.arange(3))
    np.testing.assert_allclose(again, plain, atol=1e-9)


def test_friction_changes_in_its_row_alone(world):
    swing(world, [(1.0, 1.0, 1.0), (1.0, 0.5, 1.0)], np.arange(2))
    if world.engine == "PyBullet":
        bodies = [simulation.body for simulation in world.sims[:2]]
        plain, slippery = (
            [b.physics.client.getDynamicsInfo(b.body, k)[1] for k in sorted(b.links.values())]
            for b in bodies
        )
    else:
        plain, slippery = world.sims.batch.expand("geom_friction")[:2]
    np.testing.assert_allclose(slippery, 0.5 * np.array(plain))


def test_each_episode_draws_its_own_dynamics(world):
    adapter = DomainRandomisation(world, world.robot, mass=(0.5, 2.0), motor_gain=0.9)
    adapter.dynamics = Mock()
    home = world.robot.home["home"]
    for seeds, rows in (([7, 8, 7], None), ([9], np.array([1]))):
        n = len(seeds)
        adapter.seed(np.array(seeds, dtype=np.uint64), np.arange(n) if rows is None else rows)
        adapter.reset(planar_pose(*np.zeros((3, n))), np.tile(home, (n, 1)), rows)
    first, again = (call.args for call in adapter.dynamics.scale_dynamics.call_args_list)
    for mass, friction, motor_gain, _ in (first, again):
        assert np.all((mass >= 0.5) & (mass <= 2.0))
        assert set(friction) == {1.0}
        assert set(motor_gain) == {0.9}
    assert first[0][0] == first[0][2] != first[0][1]
    assert first[0][1] != again[0][0]
    assert again[3].tolist() == [1]


def test_the_analytic_world_has_no_dynamics():
    robot, adapters = load_robot("hsr"), read_sim2real("randomised").adapters
    with pytest.raises(KinfeasError, match=r"domain_randomisation.*dynamics"):
        World(robot, load_task("ggr", {}), WorldConfig(adapters=adapters), seed=0)
