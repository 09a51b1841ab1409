from unittest.mock import Mock

import numpy as np
import pytest

from kinfeas.config import registry
from kinfeas.control.assemble import read_sim2real
from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import planar_pose
from kinfeas.envs.world import World, WorldConfig
from kinfeas.robots.loading import load_robot
from kinfeas.sim2real.adapters.dynamics import (
    AccelerationLimit,
    ActuatorLag,
    DomainRandomisation,
    JointLimitClamp,
    VelocityClamp,
)
from kinfeas.tasks.loading import load_task

DT, TICKS = 0.02, 40
PARTS = ((slice(0, 3), "linear"), (slice(3, 6), "angular"))
LIMITS = {"linear": 0.7, "angular": 1.5}
JERKS = {"linear_jerk": 4.0, "angular_jerk": 6.0}


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


def rates(values, dt):
    """Return how fast values change, from rest, shape (steps, n, 6)."""
    return np.diff(np.concatenate([np.zeros((1, *values.shape[1:])), values]), axis=0) / dt


@pytest.mark.parametrize("dt", [0.02, 0.1])
@pytest.mark.parametrize("jerks", [{}, JERKS])
def test_accelerations_are_never_exceeded(rig, drive, dt, jerks):
    limited = rig(AccelerationLimit, n=20, **LIMITS, **jerks)
    limited.run(drive(300, n=20) * 3.0, dt)
    acceleration = rates(limited.passed, dt)
    jerk = rates(acceleration, dt)
    for part, name in PARTS:
        norms = np.linalg.norm(acceleration[..., part], axis=-1)
        assert norms.max() <= LIMITS[name] * (1.0 + 1e-9)
        assert norms.max() > 0.9 * LIMITS[name]
        if jerks:
            assert np.linalg.norm(jerk[..., part], axis=-1).max() <= JERKS[f"{name}_jerk"] * 1.001


@pytest.mark.parametrize("dt", [0.01, 0.05])
def test_a_ramp_takes_the_time_that_it_must(rig, dt):
    limited = rig(AccelerationLimit, linear=0.5, angular=1.0)
    limited.run(np.tile([1.0, 0, 0, 0, 0, -1.0], (round(3.0 / dt), 1)), dt)
    t = dt * np.arange(1, round(3.0 / dt) + 1)
    np.testing.assert_allclose(limited.passed[:, 0, 0], np.minimum(0.5 * t, 1.0), atol=1e-12)
    np.testing.assert_allclose(limited.passed[:, 0, 5], -np.minimum(t, 1.0), atol=1e-12)


@pytest.mark.parametrize("dt", [0.01, 0.02, 0.1])
def test_limits_of_jerk_do_not_make_velocities_overshoot(rig, dt):
    limited = rig(AccelerationLimit, linear=2.0, angular=3.0, **JERKS)
    limited.run(np.tile([0.3, 0, 0, 0, 0, -0.5], (round(2.0 / dt), 1)), dt)
    for axis, velocity, jerk in ((0, 0.3, 4.0), (5, -0.5, 6.0)):
        reached = limited.passed[:, 0, axis] / velocity
        assert reached[-1] == pytest.approx(1.0)
        assert reached.max() <= 1.0 + 0.25 * jerk * dt**2 / abs(velocity)


@pytest.mark.parametrize("dt", [0.02, 0.1])
def test_velocities_are_never_exceeded(rig, drive, pr2, dt):
    clamped = rig(VelocityClamp, n=9, linear=0.1, angular=0.3, joints=0.5)
    sent = np.random.default_rng(0).uniform(-3.0, 3.0, (50, 9, 7))
    twists = drive(50, n=9) * 2.0
    clamped.run(twists, dt, sent)
    assert np.linalg.norm(clamped.passed[..., :3], axis=-1).max() == pytest.approx(0.1)
    assert np.abs(clamped.passed[..., 5]).max() == pytest.approx(0.3)
    turned = np.cross(clamped.passed[..., :3], twists[..., :3])
    np.testing.assert_allclose(turned, 0.0, atol=1e-15)
    moves = np.diff(np.concatenate([clamped.joints[np.newaxis], clamped.sent]), axis=0)
    moves = np.where(clamped.adapter.continuous, np.angle(np.exp(1j * moves)), moves)
    assert np.all(np.abs(moves) <= 0.5 * pr2.max_joint_velocity * dt * (1.0 + 1e-9))


@pytest.mark.parametrize("margin", [0.0, 0.05])
def test_joint_targets_stay_within_the_limits(rig, drive, pr2, margin):
    clamped = rig(JointLimitClamp, margin=margin)
    sent, twists = np.random.default_rng(0).uniform(-3.0, 3.0, (50, 1, 7)), drive(50)
    clamped.run(twists, targets=sent)
    lower, upper = pr2.joint_limits
    np.testing.assert_array_equal(clamped.sent, sent.clip(lower + margin, upper - margin))
    np.testing.assert_array_equal(clamped.passed, twists)


@pytest.mark.parametrize("dt", [0.01, 0.1, 0.25])
@pytest.mark.parametrize("time", [0.05, 0.4])
def test_step_responses_are_exponential_at_any_rate(rig, dt, time):
    lagging = rig(ActuatorLag, base=time, arm=0.5 * time)
    steps = round(2.0 / dt)
    targets = np.full((steps, 1, 7), 0.5)
    states = lagging.run(np.tile([1.0, 0, 0, 0, 0, 0], (steps, 1)), dt, targets)
    t = dt * np.arange(1, steps + 1)
    arm = 0.5 * (1.0 - np.exp(-t / (0.5 * time)))
    np.testing.assert_allclose(lagging.sent[:, 0, 0], arm, atol=1e-12)
    x = np.array([state.base_pose[0, 0] for state in states])
    np.testing.assert_allclose(x, t - time * (1.0 - np.exp(-t / time)), atol=1e-12)
