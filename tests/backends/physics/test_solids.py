import numpy as np
import pytest

from kinfeas.backends.analytic import AnalyticBackend
from kinfeas.core import spatial
from kinfeas.core.solids import Solids
from kinfeas.kinematics.ik import IkSolver
from kinfeas.kinematics.solids import collides
from tests.builders import twist

DT, ROWS = 0.02, np.arange(2)


@pytest.fixture
def rooms(hsr, opened):
    """A function that builds a world of two robots: a box beside one, a board before the other."""

    def build():
        world = opened(hsr)
        world.reset(*start(hsr))
        solids = Solids.empty(2, 3)
        solids.pose[:, 1] = [[0.0, 0.6, 0.0], [0.8, 0.1, 0.3]]
        solids.size[:, 1] = [[0.3, 0.3, 0.0, 0.5], [0.25, 0.25, 0.3, 1.5]]
        solids.cylinder[1, 1] = True
        solids.velocity[:, 1] = [[0.02, 0.03], [-0.1, 0.0]]
        solids.span[:, 1] = [0.03, 1.0]
        world.place_solids(solids, ROWS)
        return world

    return build


def start(robot):
    return spatial.planar_pose(*np.zeros((3, 2))), np.stack([robot.home["home"]] * 2)


def run(world, ticks, *command):
    _, joints = start(world.robot)
    for _ in range(ticks):
        yield world.step(np.repeat(twist(*command), 2, axis=0), joints, DT)


def test_contacts_are_those_of_the_geometry(rooms, hsr):
    world, model, seen = rooms(), IkSolver(hsr).collision, []
    for state in run(world, 100, 0.0, 0.1):
        found = [world.contacts(row) for row in ROWS]
        touched = [[len(one.base) > 0, len(one.arm) > 0] for one in found]
        shapes = state.joint_positions, state.base_pose, world.solids.after()
        seen.append((touched, collides(model, *shapes)))
    by_engine, by_geometry = np.swapaxes(seen, 0, 1)
    assert by_geometry.any(axis=0).tolist() == [[True, False], [False, True]]
    assert by_engine.any(axis=0).tolist() == [[True, False], [False, True]]
    assert np.abs(np.argmax(by_engine, axis=0) - np.argmax(by_geometry, axis=0)).max() <= 2
    assert world.touched(0) == ["solid 1"]


def test_solids_move_and_are_scanned_as_in_the_analytic_world(rooms, hsr):
    world, analytic = rooms(), AnalyticBackend(hsr)
    for _ in range(2):  # there and back
        (*_, state) = run(world, 90)
        analytic.reset(state.base_pose, state.joint_positions)
        analytic.place_solids(world.solids.after(), ROWS)
        near, measured = (each.obstacle_distances(1.0).distance for each in (analytic, world))
        assert measured[0].min() == pytest.approx(near[0].min(), abs=2e-3)
    np.testing.assert_array_equal(world.scan(), analytic.scan())
    assert world.scan().min() < 1.0


def test_closing_speeds_are_those_of_the_analytic_world(rooms, hsr):
    world, analytic, speeds = rooms(), AnalyticBackend(hsr), []
    (*_, state) = run(world, 20, 0.0, 0.3)
    analytic.reset(state.base_pose, state.joint_positions)
    analytic.place_solids(world.solids.after(), ROWS)
    for found in (world.obstacle_distances(1.0), analytic.obstacle_distances(1.0)):
        speeds.append(found.closing_speed[ROWS, found.distance.argmin(axis=1)])
    assert np.all(np.abs(speeds[0]) > 0.01)
    np.testing.assert_allclose(*speeds, atol=5e-3)


def test_a_reset_takes_solids_away_and_leaves_no_trace(rooms, hsr):
    world, fresh = rooms(), rooms()
    joints = [state.joint_velocities for state in run(world, 40, 0.0, 0.1)]
    world.reset(*(one[1:] for one in start(hsr)), ROWS[1:])
    assert world.touched(1) == []
    assert world.solids.after().filled.any(axis=1).tolist() == [True, False]
    world.place_solids(fresh.solids.start.of(ROWS[1:]), ROWS[1:])
    world.reset(*start(hsr))
    world.place_solids(fresh.solids.start, ROWS)
    np.testing.assert_array_equal([s.joint_velocities for s in run(world, 40, 0.0, 0.1)], joints)


def test_more_solids_of_one_robot_are_none_of_others(rooms):
    world = rooms()
    more = Solids.empty(1, 5)
    more.pose[0, :, :2], more.size[0] = [5.0, 5.0], [0.3, 0.3, 0.0, 0.5]
    joints = world.robot.home["home"][np.newaxis]
    world.reset(spatial.planar_pose(*np.zeros((3, 1))), joints, ROWS[1:])
    world.place_solids(more, ROWS[1:])
    for _ in run(world, 3):
        assert not world.touched(0)
