"""What issue and docs promise of the speed of the PyBullet world; in processor time of one core."""

import time

import numpy as np
import pytest

from kinfeas.policies.loading import load_policy
from kinfeas.robots.loading import load_robot
from kinfeas.tasks.loading import load_task

pytest.importorskip("pybullet")

from kinfeas.envs.physics import physics_config
from kinfeas.evaluation.physics.world import PhysicsTrial, PhysicsWorld

SECONDS = 2.0


@pytest.fixture(scope="module", params=["pr2", "hsr"])
def started(request):
    """A robot in the full room, in the midst of a task."""
    robot = load_robot(request.param)
    world = PhysicsWorld(
        PhysicsTrial(robot, load_task("door"), settings=physics_config(robot).world)
    )
    policy = load_policy("follow_ee_feedback", robot)
    world.world.start([0])
    step(world, policy, 10)  # kernels compile
    yield world, policy
    world.close()


def step(world, policy, ticks):
    for _ in range(ticks):
        world.world.step(policy.act(world.world.loop.policy_input))


def test_three_times_as_fast_as_real_time(started):
    world, policy = started
    dt = world.world.config.dt
    assert (dt, world.stage.backend.sims[0].physics.config.rate) == (0.02, 240.0)
    before = time.process_time()
    step(world, policy, round(SECONDS / dt))
    spent = time.process_time() - before
    assert SECONDS / spent >= 3.0, f"{SECONDS / spent:.1f} times real time"


def test_a_reset_takes_five_milliseconds(started):
    world, _ = started
    backend, state = world.stage.backend, world.world.loop.state
    spent = []
    for _ in range(20):
        before = time.process_time()
        backend.reset(state.base_pose, state.joint_positions)
        spent.append(time.process_time() - before)
    assert np.median(spent) <= 0.005, f"{1000 * np.median(spent):.1f} ms"
