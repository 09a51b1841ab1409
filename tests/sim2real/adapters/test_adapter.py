import inspect
from unittest.mock import Mock

import numpy as np
import pytest
from scipy.stats import kstest

from kinfeas.backends.analytic import AnalyticBackend
from kinfeas.config import PluginSpec, registry
from kinfeas.control.assemble import read_sim2real, with_adapters
from kinfeas.core.backend import ABILITIES
from kinfeas.core.errors import KinfeasError
from kinfeas.sim2real.adapters.adapter import Adapter
from kinfeas.sim2real.adapters.noise import BaseNoise, JointNoise
from tests.builders import random_bases

PHYSICS = "domain_randomisation"
NAMES = sorted({plugin.name for plugin in registry.plugins("kinfeas.adapters")} - {PHYSICS})
HARSH = read_sim2real("harsh").adapters
LISTS = pytest.mark.parametrize("adapters", [*([PluginSpec(name)] for name in NAMES), HARSH])

NEUTRAL = {"acceleration_limit": 1e9, "velocity_clamp": 1e9, "time_scale": 1}
"""Values of parameters with which an adapter does nothing, where they are not zero."""


def on_reset(backend, robot, seeds, env_ids=None):
    rows = np.arange(len(seeds)) if env_ids is None else env_ids
    backend.seed(np.array(seeds, dtype=np.uint64), rows)
    base = np.concatenate([random_bases(1, seed) for seed in seeds])
    joints = configurations(robot, [np.random.default_rng(seed) for seed in seeds])
    return backend.reset(base, joints, env_ids)


def configurations(robot, rngs):
    lower, upper = np.clip(robot.joint_limits, -np.pi, np.pi)
    return np.stack([rng.uniform(lower, upper) for rng in rngs])


def go(backend, robot, seeds, steps, firsts=0):
    """Return measurements after steps whose commands depend on seeds and numbers of steps alone."""
    measured, twist = [], np.zeros((len(seeds), 6))
    for step in range(steps):
        numbers = np.column_stack([seeds, np.broadcast_to(firsts, len(seeds)) + step])
        rngs = [np.random.default_rng(number) for number in numbers]
        twist[:, [0, 1, 5]] = [rng.normal(scale=0.1, size=3) for rng in rngs]
        measured.append(flat(backend.step(twist.copy(), configurations(robot, rngs), 0.05)))
    return np.stack(measured)


def flat(state):
    fields = [state.base_pose, state.joint_positions, state.ee_in_base]
    return np.concatenate([values for values in fields if values is not None], axis=1)


@pytest.mark.parametrize("name", NAMES)
def test_without_effect_it_is_the_identity_to_the_bit(name, pr2):
    parameters = inspect.signature(registry.load("kinfeas.adapters", name)).parameters
    keys = [key for key in parameters if key not in {"backend", "robot"} and "jerk" not in key]
    spec = PluginSpec(name, dict.fromkeys(keys, NEUTRAL.get(name, 0)))
    adapter, plain = with_adapters(AnalyticBackend(), [spec], pr2), AnalyticBackend()
    first = [flat(on_reset(world, pr2, [3, 4, 5])) for world in (adapter, plain)]
    measured, expected = (go(world, pr2, [3, 4, 5], 6) for world in (adapter, plain))
    # Where an EE is measured by itself, it comes after the rest.
    np.testing.assert_array_equal(first[0][:, : first[1].shape[1]], first[1])
    np.testing.assert_array_equal(measured[..., : expected.shape[-1]], expected)


@LISTS
def test_new_episodes_leave_the_others_alone(adapters, pr2):
    backend, alone = (with_adapters(AnalyticBackend(), adapters, pr2) for _ in "ab")
    on_reset(backend, pr2, [0, 1, 2])
    before = go(backend, pr2, [0, 1, 2], 9)
    state = flat(on_reset(backend, pr2, [8], np.array([1])))
    np.testing.assert_array_equal(state[[0, 2]], before[-1][[0, 2]])
    np.testing.assert_array_equal(state[1], flat(on_reset(alone, pr2, [8]))[0])
    after = go(backend, pr2, [0, 8, 2], 9, [9, 0, 9])
    np.testing.assert_array_equal(after[:, 1], go(alone, pr2, [8], 9)[:, 0])
    whole = with_adapters(AnalyticBackend(), adapters, pr2)
    on_reset(whole, pr2, [0])
    np.testing.assert_array_equal(after[:, 0], go(whole, pr2, [0], 18)[9:, 0])


@LISTS
def test_continues_from_a_snapshot_to_the_bit(adapters, pr2):
    twice = [*adapters, *adapters]
    backend, other = (with_adapters(AnalyticBackend(), twice, pr2) for _ in "ab")
    on_reset(backend, pr2, [5, 6])
    last = go(backend, pr2, [5, 6], 7)[-1]
    saved = backend.snapshot()
    kept = {name: values.copy() for name, values in saved.items()}
    expected = go(backend, pr2, [5, 6], 7, 7)
    for name, values in saved.items():
        np.testing.assert_array_equal(values, kept[name])
    np.testing.assert_array_equal(flat(other.restore(saved)), last)
    np.testing.assert_array_equal(go(other, pr2, [5, 6], 7, 7), expected)


def test_ranges_are_drawn_for_each_episode(rig):
    many = rig(BaseNoise, n=400, linear=(0.1, 0.3), angular=0.0)
    drawn = many.adapter.number("linear")[:, 0]
    assert 0.1 <= drawn.min() < 0.11
    assert 0.29 < drawn.max() <= 0.3
    assert kstest(drawn, "uniform", args=(0.1, 0.2)).pvalue > 1e-3
    few = rig(BaseNoise, n=3, first_seed=7, linear=(0.1, 0.3), angular=0.0)
    np.testing.assert_array_equal(few.adapter.number("linear")[:, 0], drawn[7:10])
    many.run(np.zeros((20, 6)))
    np.testing.assert_array_equal(many.adapter.number("linear")[:, 0], drawn)


@pytest.mark.parametrize(("name", "key", "value"), [
    *(("base_noise", "linear", value) for value in ("much", [1], -1, np.nan, [2, 1])),
    ("dropped_commands", "probability", 1.1),
    ("acceleration_limit", "linear", 0),
    ("velocity_clamp", "joints", 0),
    ("joint_limit_clamp", "margin", 1.0),
    ("actuator_lag", "arm", -1),
    ("head_start", "seconds", -1),
    ("head_start", "robot", 5),
    ("time_scale", "factor", 2.0),
    ("time_scale", "factor", [0.5, 1.0]),
])  # fmt: skip
def test_invalid_parameters(pr2, name, key, value):
    with pytest.raises(KinfeasError, match=f"{name}.*{key}"):
        with_adapters(AnalyticBackend(), [PluginSpec(name, {key: value})], pr2)


@pytest.mark.parametrize(("outer", "deviation"), [(BaseNoise, np.sqrt(2.0)), (JointNoise, 1.0)])
def test_random_numbers_differ_within_a_class_and_do_not_depend_on_other_classes(
    rig, outer, deviation
):
    alone, within = (rig(BaseNoise, n=2000, linear=1.0) for _ in "ab")
    around = outer(within.adapter, within.robot, **({"linear": 1.0} if outer is BaseNoise else {}))
    around.seed(np.arange(2000, dtype=np.uint64), np.arange(2000))
    around.reset(random_bases(2000), within.joints)
    around.step(np.zeros((2000, 6)), within.joints, 0.1)
    alone.run(np.zeros((1, 6)))
    assert np.std(within.passed[0, :, 0]) == pytest.approx(deviation, rel=0.06)
    assert np.array_equal(within.passed, alone.passed) is (outer is JointNoise)


def test_adapters_have_the_abilities_of_their_backend(pr2):
    bare = AnalyticBackend()
    bare.gripper, bare.resumable = Mock(), None
    adapter = Adapter(bare, pr2)
    for name in ABILITIES:
        assert getattr(adapter, name) is getattr(bare, name)
    assert Adapter(AnalyticBackend(), pr2).resumable is not None
