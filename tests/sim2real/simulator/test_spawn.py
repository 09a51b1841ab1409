import pytest

from kinfeas.robots.loading import load_robot
from kinfeas.tasks.loading import load_task

pytest.importorskip("pybullet")

from kinfeas.sim2real.simulator.spawn import set_stage


def test_begins_as_an_episode_of_a_task_does():
    robot = load_robot("pr2")
    task = load_task("drawer", {})
    places = []
    for number in (0, 0, 1):
        backend, state = set_stage(robot, task, numbers=(1, number))
        assert backend.sims[0].furniture is not None
        places.append(state.base_pose[0, 0])
        backend.close()
    assert places[0] == places[1] != places[2]
