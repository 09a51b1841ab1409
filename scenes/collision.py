"""Collisions between a robot and a scene, by python-fcl."""

from functools import lru_cache

from kinfeas.core.spatial import Array, rotation
from kinfeas.kinematics.self_collision import (
    CollisionModel,
    CollisionScratch,
    build_collision_model,
    make_collision_scratch,
    touches_itself,
)
from kinfeas.robots.robot import Robot
from kinfeas.scenes.check import ShapeGroup
from kinfeas.scenes.scene import Scene


class SceneCollision:
    """The collision shapes of a scene."""

    def __init__(self, scene: Scene) -> None:
        self.shapes = ShapeGroup(
            shape for scene_object in scene.objects.values() for _, shape in scene_object.shapes()
        )


def robot_touches(
    collision: SceneCollision, robot: Robot, base_pose: Array, joint_positions: Array
) -> bool:
    """Return whether the robot is in contact with an object of the scene; the floor is left out.

    Args:
        collision: The scene.
        robot: The robot; joints outside the arm are at `robot.fixed_joints`.
        base_pose: World pose of its base, shape (7,).
        joint_positions: Arm joints, shape (j,), radians or metres.
    """
    model, scratch, shapes = _parts(robot)
    touches_itself(model, joint_positions, scratch)  # writes the poses of the shapes
    orientation = rotation(base_pose).as_matrix()
    shapes.place(orientation @ scratch.rotation, scratch.position @ orientation.T + base_pose[:3])
    return shapes.touches(collision.shapes)


@lru_cache(maxsize=8)
def _parts(robot: Robot) -> tuple[CollisionModel, CollisionScratch, ShapeGroup]:
    model = build_collision_model(robot)
    shapes = [shape for link in robot.urdf.links.values() for shape in link.shapes]
    return model, make_collision_scratch(model), ShapeGroup(shapes)
