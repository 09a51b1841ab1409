from dataclasses import replace

import pytest

from kinfeas.backends.pybullet.task_check import check_task
from kinfeas.core.errors import KinfeasError
from kinfeas.robots.loading import load_robot
from kinfeas.scenes.scene import read_scene
from kinfeas.tasks.loading import load_task


@pytest.fixture(scope="module")
def room():
    return read_scene("room")


@pytest.fixture(scope="module")
def hsr():
    return load_robot("hsr")


@pytest.mark.parametrize("name", ["pick_place", "door", "drawer"])
def test_shipped_tasks_can_be_done(name, room, hsr):
    check_task(name, load_task(name).scene, room, hsr)


def test_a_joint_may_have_to_move_at_all(room, hsr):
    success = {"object": "door_shelf", "joint": "hinge", "threshold": 0.0}
    check_task("door", load_task("door", {"scene": {"success": success}}).scene, room, hsr)


@pytest.mark.parametrize(
    ("name", "changes", "message"),
    [
        (
            "door",
            {"success": {"object": "dor"}},
            "'scene.success.object': there is no object 'dor'; kno",
        ),
        (
            "door",
            {"success": {"joint": "hing"}},
            "'scene.success.joint': object 'door_shelf' has no mov",
        ),
        (
            "door",
            {"success": {"threshold": 2.0}},
            "'scene.success.threshold' must lie between the lim.*not 2$",
        ),
        (
            "door",
            {"success": {"threshold": -1.0}},
            "'scene.success.threshold' must.*0 and 1.92, not -1$",
        ),
        (
            "door",
            {"grasped_object": {"object": "x"}},
            "'scene.grasped_object.object': there is no object 'x'",
        ),
        (
            "door",
            {"grasped_object": {"link": "x"}},
            "'scene.grasped_object.link': object 'door_shelf' has no li",
        ),
        (
            "pick_place",
            {"success": {"parent": "tabel"}},
            "'scene.success.parent': there is no other object 'tab",
        ),
        (
            "pick_place",
            {"success": {"parent": "box"}},
            "'scene.success.parent': there is no other object 'box'",
        ),
        ("pick_place", {"moves": {"bax": {"place": "table"}}}, "'scene.moves.bax': there is no ob"),
        (
            "pick_place",
            {"grasped_object": {"object": "pick_table", "link": "table"}},
            "'scene.grasped_object': link 'table' of object 'pick_table' cannot move",
        ),
    ],
)
def test_what_a_scene_lacks_is_one_sentence(name, changes, message, room, hsr):
    task = load_task(name, {"scene": changes})
    with pytest.raises(KinfeasError, match=f"^task 'mine': {message}") as caught:
        check_task("mine", task.scene, room, hsr)
    assert "\n" not in str(caught.value)


def test_to_take_hold_needs_a_gripper(room, hsr):
    bare = replace(hsr, gripper=None)
    message = "^task 'door' takes hold of an object, and robot 'hsr' has no gripper"
    with pytest.raises(KinfeasError, match=message):
        check_task("door", load_task("door").scene, room, bare)
    check_task("door", replace(load_task("door").scene, grasped_object=None), room, bare)
