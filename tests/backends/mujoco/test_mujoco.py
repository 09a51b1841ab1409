import numpy as np
import pytest

from kinfeas.core import spatial
from kinfeas.core.solids import Solids
from tests.backends.conftest import stay
from tests.builders import twist

DT = 0.02


@pytest.fixture
def begun(hsr, scene, opened, between_fingers):
    def build(n=1):
        world = opened(hsr, scene)
        world.handle("bar", "bar")
        bases = spatial.planar_pose(np.zeros(n), np.zeros(n), np.zeros(n))
        arm = np.stack([hsr.home["home"]] * n)
        for row in range(n):
            bar = between_fingers.copy()
            bar[0] += 0.002 * row
            world.place(row, scene.with_poses({"bar": bar}), bases[row], arm[row])
        world.reset(bases, arm)
        return world

    return build


def run(world, ticks, first=0):
    n, seen = len(world._positions), []
    home = np.stack([world.robot.home["home"]] * n)
    for tick in range(first, first + ticks):
        if tick == 2:
            world.grip("close", np.arange(n))
        command = np.repeat(twist(0.1, 0.02, 0.3), n, axis=0) * np.linspace(1.0, 0.5, n)[:, None]
        state = world.step(command if tick > 5 else 0.0 * command, home, DT)
        bars = [world.object_motion(row, "bar")[0] for row in range(n)]
        seen.append(np.hstack([state.base_pose, state.joint_velocities, bars]))
    return np.array(seen)


def test_a_robot_moves_alike_alone_and_in_a_batch(begun):
    together = run(begun(3), 40)
    np.testing.assert_array_equal(run(begun(1), 40)[:, 0], together[:, 0])
    assert not np.array_equal(together[:, 0], together[:, 1])


@pytest.mark.parametrize("ticks", [3, 30])
def test_a_saved_state_continues_to_the_bit(begun, ticks):
    world, fresh = begun(3), begun(1)
    run(world, ticks)
    saved = world.snapshot()
    expected = run(world, 30, ticks)
    fresh.restore(saved)
    np.testing.assert_array_equal(run(fresh, 30, ticks), expected)
    world.restore(saved)
    np.testing.assert_array_equal(run(world, 30, ticks), expected)
    home = np.stack([world.robot.home["home"]] * 3)
    bases = spatial.planar_pose(*np.zeros((3, 3)))
    np.testing.assert_array_equal(
        fresh.reset(bases, home).base_pose, world.reset(bases, home).base_pose
    )


def test_solids_are_saved_with_their_way(hsr, opened):
    def place(world):
        world.reset(spatial.planar_pose(*np.zeros((3, 2))), np.stack([hsr.home["home"]] * 2))
        solids = Solids.empty(2, 2)
        solids.pose[:, 1], solids.size[:, 1] = [0.0, 0.6, 0.3], [0.3, 0.2, 0.0, 0.5]
        solids.cylinder[0, 1] = True
        solids.velocity[:, 1], solids.span[:, 1] = [0.0, -0.1], 0.2
        world.place_solids(solids, np.arange(2))

    def move(world):
        home = np.stack([hsr.home["home"]] * 2)
        return [world.step(np.zeros((2, 6)), home, DT).base_pose for _ in range(60)]

    world, fresh = opened(hsr), opened(hsr)
    place(world)
    move(world)
    saved = world.snapshot()
    expected = move(world)
    assert np.abs(expected[-1] - expected[0]).max() > 0.01  # pushed
    fresh.restore(saved)
    np.testing.assert_array_equal(move(fresh), expected)


def weigh(world, gravity):
    """Set the vertical gravity, m/s^2."""
    world.sims.batch.expand("opt.gravity")[:, 2] = -gravity


def close(world):
    """Close the hand about the bar, which hangs in the air."""
    weigh(world, 0.0)
    world.grip("close", np.array([0]))
    stay(world, 60)
    assert world.holds(0, "bar")
    assert not world.contacts(0).arm  # the grasped link does not count
    weigh(world, 9.81)


def test_a_grasp_carries_an_object_until_it_is_opened(begun):
    world = begun()
    assert not world.holds(0, "bar")
    close(world)
    stay(world, 50)
    # The fingers bear the rest.
    assert world.sims._grasp_force(0) == pytest.approx(0.3 * 9.81, rel=0.2)
    assert world.object_motion(0, "bar")[0][2] > 0.7
    world.grip("open", np.array([0]))
    assert not world.holds(0, "bar")
    stay(world, 60)
    assert world.object_motion(0, "bar")[0][2] < 0.2


def test_a_grasp_breaks_above_its_limit(begun):
    world = begun()
    close(world)
    weigh(world, 200.0)
    stay(world, 5)
    assert world.holds(0, "bar")
    weigh(world, 400.0)
    stay(world, 25)
    assert not world.holds(0, "bar")
