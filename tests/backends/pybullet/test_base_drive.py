import numpy as np
import pytest

from kinfeas.core import spatial
from tests.backends.pybullet.conftest import stay, twist

STEP = 1 / 240


def planar_speeds(states):
    return np.array([state.base_twist[0, [0, 1, 5]] for state in states])


@pytest.mark.parametrize("command", [twist(0.2), twist(0.2, 0.1, -0.4), twist(turn=0.4)])
def test_accelerates_no_faster_than_the_vendor_says(world, begin, command):
    begin()
    base = world.sims[0].body.robot.base
    states = stay(world, 120, command, STEP) + stay(world, 120, twist(), STEP)
    change = np.diff(planar_speeds(states), axis=0, prepend=0.0) / STEP
    assert np.hypot(change[:, 0], change[:, 1]).max() <= base.max_acceleration * 1.01
    assert np.abs(change[:, 2]).max() <= base.max_rotation_acceleration * 1.01


def test_reaches_the_velocity_and_stands_still_again(world, begin):
    begin()
    states = stay(world, 50, twist(0.15, 0.0, 0.0))
    np.testing.assert_allclose(states[-1].base_twist, twist(0.15), atol=1e-5)
    x = states[-1].base_pose[0, 0]
    assert 0.13 <= x <= 0.15
    states = stay(world, 50)
    np.testing.assert_allclose(states[-1].base_twist, twist(), atol=1e-5)
    assert x <= states[-1].base_pose[0, 0] <= x + 0.02


def test_a_differential_drive_never_slides_sideways(world, begin):
    if world.sims[0].body.robot.base.drive != "differential":
        pytest.skip("omnidirectional")
    begin(yaw=0.7)
    rng = np.random.default_rng(0)
    for _ in range(100):
        x, y, turn = rng.uniform(-0.2, 0.2, 3)
        (state,) = stay(world, 1, twist(x, y, 2.0 * turn))
        heading = spatial.yaw(state.base_pose)[0]
        sideways = [-np.sin(heading), np.cos(heading)] @ state.base_twist[0, :2]
        assert abs(sideways) <= 1e-3


def test_a_differential_drive_takes_the_part_along_its_heading(world, begin):
    begin()
    end = stay(world, 50, twist(0.1, 0.1))[-1]
    y = end.base_pose[0, 1]
    if world.sims[0].body.robot.base.drive == "differential":
        assert abs(y) <= 1e-6
    else:
        assert y == pytest.approx(end.base_pose[0, 0], rel=1e-3)


def test_a_wall_stops_the_base_and_is_pushed_no_harder_than_the_motors_can(world, begin):
    begin(x=-2.3, yaw=np.pi)
    stay(world, 150, twist(-0.2))
    body = world.sims[0].body
    before = body.state().base_pose
    after = stay(world, 25, twist(-0.2))[-1].base_pose
    assert np.linalg.norm(after[0, :2] - before[0, :2]) <= 0.005
    wall = world.sims[0].furniture.bodies["wall"]
    points = world.sims[0].physics.client.getContactPoints(bodyA=body.body, bodyB=wall)
    force = sum(point[9] for point in points)
    strongest = (
        world.sims[0].physics.config.drive_reserve * body.mass * body.robot.base.max_acceleration
    )
    assert 0.0 < force <= 1.5 * strongest


def test_a_pull_at_the_hand_does_not_turn_a_standing_base(world, begin):
    begin()
    client, body = world.sims[0].physics.client, world.sims[0].body
    hand = body.links[body.robot.ee_frame]
    for _ in range(120):
        at = client.getLinkState(body.body, hand)[4]
        client.applyExternalForce(body.body, hand, [0.0, 40.0, 0.0], at, client.WORLD_FRAME)
        (state,) = stay(world, 1, dt=STEP)
    assert abs(spatial.yaw(state.base_pose)[0]) <= 1e-3
