"""Whether a scene has what a task does something with, and a robot the hand for it."""

from collections.abc import Collection

from kinfeas.core.errors import KinfeasError, no_such
from kinfeas.robots.robot import Robot
from kinfeas.scenes.objects import free_joints, moving_joint
from kinfeas.scenes.scene import Scene
from kinfeas.tasks.chain import GraspedObject, SuccessCondition, TaskScene


def check_task(name: str, known: TaskScene, scene: Scene, robot: Robot) -> None:
    """Check that a task can be done with the objects of a scene by a robot.

    Args:
        name: Of the task.
        known: What it does to objects.
        scene: What stands there.
        robot: Who does it.

    Raises:
        KinfeasError: If the task names an object, link or joint that there is not, takes hold of
            what cannot move, wants a joint beyond its limits, or the robot has no gripper.
    """
    where = f"task {name!r}: 'scene"
    for moved in known.moves:
        _need(moved, scene.objects, f"{where}.moves.{moved}': there is no object")
    if known.grasped_object is not None:
        _check_grasped_object(known.grasped_object, scene, f"{where}.grasped_object")
        if robot.gripper is None:
            raise KinfeasError(
                f"task {name!r} takes hold of an object, and robot {robot.name!r} has no gripper: "
                "its YAML file lacks 'gripper'"
            )
    _check_success(known.success, scene, f"{where}.success")


def _check_grasped_object(grasped_object: GraspedObject, scene: Scene, where: str) -> None:
    _need(grasped_object.object, scene.objects, f"{where}.object': there is no object")
    one = scene.objects[grasped_object.object]
    _need(
        grasped_object.link,
        one.urdf.links,
        f"{where}.link': object {grasped_object.object!r} has no link",
    )
    if one.fixed and moving_joint(one.urdf, grasped_object.link) is None:
        raise KinfeasError(
            f"{where}': link {grasped_object.link!r} of object {grasped_object.object!r} cannot "
            "move: the object is fixed, and no joint is above the link"
        )


def _check_success(success: SuccessCondition, scene: Scene, where: str) -> None:
    _need(success.object, scene.objects, f"{where}.object': there is no object")
    if success.parent is not None:
        others = [name for name in scene.objects if name != success.object]
        _need(success.parent, others, f"{where}.parent': there is no other object")
    if success.joint is not None:
        joints = free_joints(scene.objects[success.object].urdf)
        _need(
            success.joint, joints, f"{where}.joint': object {success.object!r} has no moving joint"
        )
        lower, upper = joints[success.joint].lower, joints[success.joint].upper
        if not (
            lower < success.threshold if success.threshold < 0.0 else success.threshold < upper
        ):
            raise KinfeasError(
                f"{where}.threshold' must lie between the limits of joint {success.joint!r}, "
                f"{lower:g} and {upper:g}, not {success.threshold:g}"
            )


def _need(word: str, known: Collection[str], complaint: str) -> None:
    if word not in known:
        raise KinfeasError(f"{complaint} {word!r}{no_such(word, known)}")
