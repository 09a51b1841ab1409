import numpy as np
import pytest

from kinfeas.backends.analytic import AnalyticBackend
from kinfeas.control.execution import ExecutionConfig, SubgoalMotion
from kinfeas.control.loop import Loop
from kinfeas.control.motion_sequence import MotionSequence
from kinfeas.core import spatial
from kinfeas.core.errors import KinfeasError
from kinfeas.kinematics.ik import IkSolver
from kinfeas.kinematics.reachability import reachable
from kinfeas.plugins.linear import Linear
from kinfeas.robots.loading import load_robot
from kinfeas.sim2real.deploy.goal_task import begin, make_goal_task
from kinfeas.sim2real.deploy.guard_config import Guards
from kinfeas.sim2real.deploy.preflight import preview, subgoal_poses, top_speed
from kinfeas.tasks.loading import load_task
from kinfeas.tasks.task import MotionSpec, build_subgoals


@pytest.fixture(scope="module")
def solvers():
    return {name: IkSolver(load_robot(name)) for name in ("pr2", "tiago", "hsr")}


def goal(*position, rpy=None):
    return make_goal_task(position, rpy, MotionSpec())


def seen(solver, task, guards, execution=None):
    """Return what a preview of a task warns of, and what is drawn after it."""
    rng = np.random.default_rng(3)
    loop = Loop(solver, build_subgoals(task.subgoals), AnalyticBackend(), 0.02, execution)
    warning = preview(loop, begin(task, solver, rng, None), rng, guards)
    return warning, rng.random()


def sequence(*targets, generator=None):
    """Return a motion sequence through positions, shape (3,), from the origin."""
    poses = np.tile(spatial.IDENTITY, (1, len(targets), 1))
    poses[0, :, :3] = targets
    begun = MotionSequence(
        [SubgoalMotion(generator or Linear())] * len(targets), load_robot("pr2"), 1
    )
    begun.start(spatial.IDENTITY[np.newaxis], poses, [np.random.default_rng(0)])
    return begun


def test_the_ends_of_all_subgoals():
    targets = [(1.0, 0.0, 0.0), (1.0, 2.0, 0.0), (0.0, 0.0, 0.5)]
    np.testing.assert_allclose(subgoal_poses(sequence(*targets))[:, :3], targets)


@pytest.mark.parametrize(
    ("targets", "speed"),
    [
        ([(0.5, 0.0, 0.0)], 0.05),
        ([(0.5, 0.0, 0.0), (5.0, 0.0, 0.0)], 0.1),
        ([(5.0, 0.0, 0.0), (5.0, 0.1, 0.0)], 0.1),
        ([(0.0, 0.0, 0.0)], 0.0),
    ],
)
def test_the_fastest_moment_of_all_subgoals(targets, speed):
    assert top_speed(sequence(*targets)) == pytest.approx(speed)


def test_a_motion_that_never_arrives_is_looked_at_for_a_while():
    slow = Linear(gain=1e-6, min_velocity=1e-6)
    assert top_speed(sequence((1.0, 0.0, 0.0), generator=slow)) == pytest.approx(1e-6)


@pytest.mark.parametrize("name", ["pr2", "tiago", "hsr"])
def test_goals_within_reach_are_fine(solvers, name):
    for position in ((0.9, 0.1, 0.8), (-3.0, 2.0, 0.6)):
        assert seen(solvers[name], goal(*position), Guards())[0] == ""


@pytest.mark.parametrize("name", ["pr2", "tiago", "hsr"])
@pytest.mark.parametrize("task", ["door", "drawer", "pick_place"])
def test_the_tasks_that_come_along_are_fine(solvers, name, task):
    assert seen(solvers[name], load_task(task, {}), Guards())[0] == ""


@pytest.mark.parametrize("height", [-0.5, 2.2, 90.0])
def test_a_goal_out_of_reach_is_refused(solvers, height):
    with pytest.raises(KinfeasError) as caught:
        seen(solvers["pr2"], goal(1.5, 0.0, height, rpy=(0.0, 0.1, -0.2)), Guards())
    assert str(caught.value) == (
        "no base pose was found from which the arm reaches the goal, "
        f"x 1.5, y 0, z {height:g} m, roll 0, pitch 0.1, yaw -0.2 rad; "
        "--set guards.reach=false goes there all the same"
    )
    assert seen(solvers["pr2"], goal(1.5, 0.0, height), Guards(reach=False))[0] == ""


def test_as_near_as_counts_as_there_is_within_reach(solvers):
    high = (1.5, 0.0, 1.28)
    pose = spatial.IDENTITY.copy()
    pose[:3] = high
    assert not reachable(solvers["pr2"], pose[np.newaxis]).reached.any()
    assert seen(solvers["pr2"], goal(*high), Guards())[0] == ""


@pytest.mark.parametrize(
    ("speed", "slow_down", "warns"),
    [
        (None, 1.0, False),
        (0.1, 1.0, False),
        (0.09, 1.0, True),
        (0.05, 2.0, False),
        (0.05, 1.9, True),
    ],
)
def test_a_hand_that_outruns_the_base_is_warned_of(solvers, speed, slow_down, warns):
    guards, far = Guards(max_linear_velocity=speed), goal(4.0, 0.0, 0.8)
    warning, _ = seen(solvers["hsr"], far, guards, ExecutionConfig(slow_down=slow_down))
    assert bool(warning) is warns


def test_the_warning_says_what_slows_the_hand_down_as_much(solvers):
    warning, _ = seen(solvers["hsr"], goal(4.0, 0.0, 0.8), Guards(max_linear_velocity=0.05))
    assert warning == (
        "guards.max_linear_velocity slows down the base alone, to 0.05 m/s; the hand, which is to "
        "move at up to 0.1 m/s, may leave it behind: --set slow_down=4 slows it down as much"
    )


def test_a_look_draws_nothing(solvers):
    task = load_task("ggr", {})
    looked = seen(solvers["pr2"], task, Guards(max_linear_velocity=0.01))
    assert looked[0]
    assert looked[1] == seen(solvers["pr2"], task, Guards(reach=False))[1]
