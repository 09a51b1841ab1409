"""Does a robot touch the furniture? Exactly, by python-fcl, for starts that must not."""

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
from kinfeas.scenes.check import Solids
from kinfeas.scenes.scene import Scene


class SceneCollision:
    """The shapes of a scene as it stands, ready to be touched."""

    def __init__(self, scene: Scene) -> None:
        self.solids = Solids(shape for one in scene.objects.values() for _, shape in one.shapes())


def robot_touches(
    collision: SceneCollision, robot: Robot, base_pose: Array, joint_positions: Array
) -> bool:
    """Return whether any part of a robot touches anything of a scene; its floor is not looked at.

    Args:
        collision: The scene.
        robot: What stands in it, its joints other than the arm's at rest.
        base_pose: World pose of its base, shape (7,).
        joint_positions: Arm joints, shape (j,), radians or metres.
    """
    model, scratch, solids = _parts(robot)
    touches_itself(model, joint_positions, scratch)  # for the places that it leaves in `scratch`
    turn = rotation(base_pose).as_matrix()
    solids.place(turn @ scratch.rotation, scratch.position @ turn.T + base_pose[:3])
    return solids.touches(collision.solids)


@lru_cache(maxsize=8)
def _parts(robot: Robot) -> tuple[CollisionModel, CollisionScratch, Solids]:
    """Return the robot's shapes, in the order of its collision model, and what places them."""
    model = build_collision_model(robot)
    shapes = [shape for link in robot.urdf.links.values() for shape in link.shapes]
    return model, make_collision_scratch(model), Solids(shapes)
