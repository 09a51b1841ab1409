from dataclasses import replace

import numpy as np
import pytest

from kinfeas.backends.analytic import AnalyticBackend
from kinfeas.control.assemble import assemble
from kinfeas.core import spatial
from kinfeas.core.backend import RobotState
from kinfeas.core.errors import KinfeasError
from kinfeas.core.solids import Solids
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolver
from kinfeas.planning.placement import reachable
from kinfeas.robots.loading import load_robot
from kinfeas.sim2real.deploy.config import Guards
from kinfeas.sim2real.deploy.start import begin, make_goal_task, preflight
from kinfeas.sim2real.link.rate import Clock, Rate
from kinfeas.tasks.loading import load_task
from kinfeas.tasks.task import MotionSpec, build_subgoals
from tests.builders import at

HSR = IkSolver(load_robot("hsr"))
AT_HOME = RobotState(at(), HSR.robot.home["home"][np.newaxis])


def goal(*position, rpy=None):
    return make_goal_task(position, rpy, MotionSpec())


def checked(task, guards, solver=HSR):
    rng = np.random.default_rng(3)
    loop = assemble(solver, build_subgoals(task.subgoals), AnalyticBackend(), dt=0.02)
    return preflight(loop, begin(task, solver, rng, None), rng, guards)


@pytest.mark.parametrize("task", [
    *map(load_task, ("door", "drawer", "pick_place")), goal(0.9, 0.1, 0.8), goal(-3.0, 2.0, 0.6),
])  # fmt: skip
def test_reachable_goals_pass(task):
    assert checked(task, Guards()) == ""


@pytest.mark.parametrize("height", [-0.5, 2.2, 90.0])
def test_a_goal_out_of_reach_is_an_error_with_its_pose(height):
    task = goal(1.5, 0.0, height, rpy=(0.0, 0.1, -0.2))
    pose = f"x 1.5, y 0, z {height:g} m, roll 0, pitch 0.1, yaw -0.2 rad"
    with pytest.raises(KinfeasError, match=pose):
        checked(task, Guards())
    assert checked(task, Guards(reach=False)) == ""


def test_the_tolerance_is_that_of_a_reached_goal():
    pr2, high = IkSolver(load_robot("pr2")), (1.5, 0.0, 1.28)
    pose = np.array([[*high, 0.0, 0.0, 0.0, 1.0]])
    assert not reachable(pr2, pose).reached.any()
    assert checked(goal(*high), Guards(), solver=pr2) == ""


@pytest.mark.parametrize("real", [None, replace(AT_HOME, base_pose=at(3.0, 1.0, 2.0))])
def test_begins_where_the_robot_is_with_its_orientation_as_the_goal(real):
    start = begin(goal(1.0, 2.0, 0.5), HSR, np.random.default_rng(1), real)
    expected = real or AT_HOME
    np.testing.assert_array_equal(start.base_pose, expected.base_pose)
    np.testing.assert_array_equal(start.joint_positions, expected.joint_positions)
    ee = spatial.compose(expected.base_pose, forward(HSR.chain, expected.joint_positions))
    np.testing.assert_allclose(start.target_poses[0, 0], [1.0, 2.0, 0.5, *ee[0, 3:]], atol=1e-12)


def test_an_orientation_is_given_by_angles_or_a_quaternion():
    half = np.sqrt(0.5)
    for angles in ((0.0, 0.0, np.pi / 2.0), (0.0, 0.0, half, half)):
        orientation = goal(0.0, 0.0, 1.0, rpy=angles).orientation
        np.testing.assert_allclose(orientation, [0.0, 0.0, half, half], atol=1e-12)
    for x, angles in ((np.nan, None), (0.0, (np.inf, 0.0, 0.0)), (0.0, (0.0, 0.0, 0.0, 0.0))):
        with pytest.raises(KinfeasError, match="goal"):
            goal(x, 0.0, 0.0, rpy=angles)


@pytest.mark.parametrize(("task", "known"), [("ggr_obstacles", 0), ("shelf", 15), ("door", 39)])
def test_only_furniture_and_given_solids_are_known_around_a_real_robot(task, known):
    drawn = load_task(task), HSR, np.random.default_rng(0)
    start = begin(*drawn, AT_HOME)
    assert (0 if start.solids is None else int(start.solids.filled.sum())) == known
    box = Solids.from_table(np.array([[2.0, 0, 0, 0.2, 0.2, 0, 1, 0, 0, 0, 0]]))
    for measured in (None, AT_HOME):
        assert begin(*drawn, measured, box).solids.table.tolist() == box.table.tolist()


def test_late_awakenings_do_not_add_up(time):
    clock = Clock(lambda: time.monotonic, sleep=lambda seconds: time.passes(seconds + 0.001))
    rate = Rate(0.02, clock)
    rate.wait()
    for _ in range(1000):
        time.passes(0.003)
        rate.worked()
        time.passes(0.002)  # of the simulated world
        rate.wait()
    assert time.monotonic == pytest.approx(1000.0 + 1000 * 0.02 + 0.001, abs=1e-6)
    timing = rate.timing()
    assert (timing.periods, timing.misses) == (1000, 0)
    assert (timing.p50, timing.work_p50, timing.work_p99) == pytest.approx((0.02, 0.003, 0.003))


@pytest.mark.parametrize(
    ("late", "periods"), [(0.025, [0.025, 0.015, 0.02]), (0.09, [0.09, 0.01, 0.02])]
)
def test_a_late_period_is_counted_and_shifts_no_deadline(time, late, periods):
    rate = Rate(0.02, time.clock)
    assert rate.wait() == 0.0
    time.passes(late)
    np.testing.assert_allclose([rate.wait() for _ in range(3)], periods, atol=1e-9)
    assert rate.timing().misses == 1


def test_work_is_prepared_shortly_before_the_end_of_a_period(time):
    rate, begun = Rate(0.02, time.clock), []
    rate.wait()

    def prepare():
        begun.append(time.monotonic - 1000.0)
        time.passes(0.002)

    rate.prepare = prepare
    periods = [rate.wait() for _ in range(2)]
    time.passes(0.019)
    periods.append(rate.wait())  # too late to prepare anything
    np.testing.assert_allclose(periods, 0.02)
    np.testing.assert_allclose(begun, [0.01, 0.036])
