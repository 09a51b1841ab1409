from dataclasses import astuple
from itertools import product

import numpy as np
import pytest

from kinfeas.backends.analytic import AnalyticBackend
from kinfeas.config import PluginSpec
from kinfeas.config.recipes import recipes
from kinfeas.control.assemble import read_sim2real, with_adapters
from kinfeas.control.execution import ExecutionConfig
from kinfeas.control.surroundings import Surroundings
from kinfeas.core.backend import SCAN_BEAMS, SCAN_RANGE, BackendWrapper
from kinfeas.core.response import ResponseModel
from kinfeas.envs.world import World, WorldConfig
from kinfeas.kinematics.ik import IkSolver
from kinfeas.robots.loading import load_robot
from kinfeas.tasks.ggr import ggr

LADDER = ("ideal", "paper", "pr2_like", "harsh", "randomised")


def test_shipped_lists_suit_any_robot():
    assert recipes("sim2real") == sorted(f"sim2real/{name}" for name in LADDER)
    for name, robot in product(LADDER, map(load_robot, ("pr2", "tiago", "hsr"))):
        world = AnalyticBackend()
        world.dynamics = world  # that of a simulator with physics
        backend = with_adapters(world, read_sim2real(name).adapters, robot)
        assert backend.execution(ExecutionConfig(time_scale=0.5)).time_scale <= 0.5


def test_the_first_adapter_is_innermost_and_each_changes_the_execution_once(pr2):
    names = "time_scale", "time_scale", "base_noise", "head_start"
    jittered = PluginSpec("head_start", {"seconds": [0.5, 1.5]})
    adapters = [*(PluginSpec(name) for name in names), jittered]
    backend, kinds = with_adapters(AnalyticBackend(), adapters, pr2), []
    execution = backend.execution(ExecutionConfig(time_scale=0.8, head_start=1.0))
    while isinstance(backend, BackendWrapper):
        kinds, backend = [*kinds, type(backend).__name__], backend.backend
    assert kinds == ["HeadStart", "HeadStart", "BaseNoise", "TimeScale", "TimeScale"]
    assert execution == ExecutionConfig(time_scale=0.2, head_start=4.5, head_start_jitter=1.0)


def test_adapters_state_the_mean_response_of_their_ranges(pr2):
    backend = with_adapters(AnalyticBackend(), read_sim2real("harsh").adapters, pr2)
    expected = ResponseModel(
        command_latency=0.095, sensor_latency=0.05, base_lag=0.175, arm_lag=0.04,
        acceleration=0.7, rotation_acceleration=1.3, jerk=5.0, rotation_jerk=10.0,
    )  # fmt: skip
    assert astuple(backend.response) == pytest.approx(astuple(expected))


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


def test_without_a_scanner_nothing_is_in_range_with_one_warning(hsr, caplog):
    backend = AnalyticBackend(hsr)
    backend.scanner = None
    surroundings = Surroundings(backend, IkSolver(hsr).collision)
    for n in (1, 3):
        np.testing.assert_array_equal(
            surroundings.ranges(n), np.full((n, 2, SCAN_BEAMS), SCAN_RANGE)
        )
    (warning,) = caplog.messages
    assert backend.name in warning
