from dataclasses import replace

import numpy as np
import pytest

from kinfeas import config
from kinfeas.core.errors import KinfeasError
from kinfeas.evaluation.reachability import measure_reachability
from kinfeas.kinematics.ik import IkOptions
from kinfeas.tasks.chain import ChainTask
from kinfeas.tasks.ggr import ggr
from kinfeas.tasks.loading import load_task


@pytest.mark.slow
def test_ceilings_of_the_documentation(robot):
    share = measure_reachability(robot, ggr(), 150, 1).share
    least, most = {"pr2": (0.95, 1.0), "tiago": (0.86, 0.98), "hsr": (0.9, 1.0)}[robot.name]
    assert least <= share.value <= most
    assert share.low < share.value < share.high or share.value == 1.0


def test_a_pose_tolerance_ends_at_the_tolerance_of_the_goal(hsr):
    task = ggr(heights=(0.05, 1.7))
    strict = measure_reachability(hsr, task, 40, 1).reached
    exact = measure_reachability(hsr, task, 40, 1, IkOptions(pose_tolerance=False)).reached
    assert exact.sum() < strict.sum() < 40
    assert not np.any(exact & ~strict)


def reach(*heights):
    """Return a task whose sub-goals are at these heights, one metre ahead."""
    places = {f"at {z}": {"position": [1.0, 0.0, z]} for z in heights}
    subgoals = [{"place": name} for name in places]
    data = {"name": "reach", "places": places, "subgoals": subgoals, "start": {"square": 0.0}}
    return config.from_mapping(ChainTask, data, "test")


def test_every_sub_goal_counts(hsr):
    assert measure_reachability(hsr, reach(0.7, 0.9), 2, 0).share.value == 1.0
    for heights in ((0.7, 3.0), (3.0, 0.7)):
        result = measure_reachability(hsr, reach(*heights), 2, 0)
        assert result.reached.tolist() == [False, False]
        assert result.convergence == (0.0,) * 5


def test_limits_name_the_sub_goal_and_what_keeps_it_out_of_reach(hsr):
    task = reach(0.7, 3.0)
    limits = measure_reachability(hsr, task, 2, 0, limits=True).limits
    assert limits == ({}, {"height": 2})
    under = replace(task.places["at 3.0"], position=(1.0, 0.0, 1.2), rpy=(3.14, 0.0, 0.0))
    turned = replace(task, places={**task.places, "at 3.0": under})
    for path in (False, True):
        limits = measure_reachability(hsr, turned, 2, 0, path=path, limits=True).limits
        assert limits[1] == {"orientation": 2}
    assert measure_reachability(hsr, task, 2, 0).limits == ()


def test_paths_are_harder_than_goals(hsr):
    goals, done = measure_reachability(hsr, ggr(), 16, 1), []
    path = measure_reachability(hsr, ggr(), 16, 1, on_done=done.append, path=True)
    assert not np.any(path.reached & ~goals.reached)
    assert sum(done) == pytest.approx(1.0)
    assert list(path.convergence) == sorted(path.convergence)


def test_streams_have_no_ceiling(hsr):
    with pytest.raises(KinfeasError, match="joystick"):
        measure_reachability(hsr, load_task("joystick"), 2, 1)
