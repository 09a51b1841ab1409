import numpy as np
import pytest

from kinfeas.config import registry
from kinfeas.core.solids import Solids
from kinfeas.core.spatial import planar_pose
from kinfeas.robots.loading import load_robot
from tests.builders import twist

DT = 0.02


@pytest.fixture(scope="session")
def engine():
    pytest.importorskip("mujoco")
    return registry.load("kinfeas.backends", "mujoco")


@pytest.fixture
def begun(hsr, scene, opened):
    """A function that builds n robots before a bar, each with a solid that moves toward it."""

    def build(n=1):
        world = opened(hsr, scene)
        world.handle("bar", "bar")
        bases, arms = planar_pose(*np.zeros((3, n))), np.stack([hsr.home["home"]] * n)
        for row in range(n):
            bar = np.array([0.6, 0.08 + 0.002 * row, 0.72, 0.0, 0.0, 0.0, 1.0])
            world.place(row, scene.with_poses({"bar": bar}), bases[row], arms[row])
        world.reset(bases, arms)
        solids = Solids.empty(n, 2)
        solids.pose[:, 1], solids.size[:, 1] = [0.0, 0.5, 0.3], [0.2, 0.2, 0.0, 0.5]
        solids.cylinder[0, 1], solids.velocity[:, 1], solids.span[:, 1] = True, [0.0, -0.1], 0.2
        world.place_solids(solids, np.arange(n))
        return world

    return build


def run(world, ticks, first=0):
    """Return measurements of all robots, which close their hands and then drive."""
    n, measured = len(world.solids.seconds), []
    home = np.stack([world.robot.home["home"]] * n)
    for tick in range(first, first + ticks):
        if tick == 2:
            world.grip("close", np.arange(n))
        command = np.repeat(twist(0.1, 0.02, 0.3), n, axis=0) * np.linspace(1.0, 0.5, n)[:, None]
        state = world.step(command if tick > 5 else 0.0 * command, home, DT)
        bars = [world.object_motion(row, "bar")[0] for row in range(n)]
        measured.append(np.hstack([state.base_pose, state.joint_velocities, bars]))
    return np.array(measured)


@pytest.mark.parametrize("ticks", [3, 60])
def test_a_saved_state_continues_to_the_bit(begun, ticks):
    world, fresh = begun(3), begun(1)
    run(world, ticks)
    saved = world.snapshot()
    expected = run(world, 60, ticks)
    assert np.abs(expected[-1] - expected[0]).max() > 0.01
    for other in (fresh, world):
        other.restore(saved)
        np.testing.assert_array_equal(run(other, 60, ticks), expected)
    home, bases = np.stack([world.robot.home["home"]] * 3), planar_pose(*np.zeros((3, 3)))
    again = [one.reset(bases, home).base_pose for one in (fresh, world)]
    np.testing.assert_array_equal(*again)


def test_coupled_joints_without_effort_limits_are_stable(opened):
    world = opened(load_robot("stretch4"))
    lower, upper = world.robot.finite_joint_limits
    arm = np.stack([lower + share * (upper - lower) for share in (0.1, 0.9)])
    world.reset(planar_pose(*np.zeros((3, 1))), arm[:1])
    for tick in range(300):
        state = world.step(twist(0.1, 0.02, 0.3), arm[[tick // 150 % 2]], DT)
    np.testing.assert_allclose(state.joint_positions[0], arm[1], atol=0.01)
