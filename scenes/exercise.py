"""What the simulated hand is to do: take a handle of the room and open what it moves."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from kinfeas import config
from kinfeas.config.quantities import Positive, Vector
from kinfeas.config.schema import no_such
from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import Array, rotation
from kinfeas.scenes.mechanism import MechanismJoint
from kinfeas.scenes.objects import SceneObject, moving_joint
from kinfeas.scenes.scene import Scene, read_scene

EXERCISES = ("door", "drawer")
"""Each is a handle of the room, too."""

Corners = tuple[tuple[float, float], tuple[float, float]]

_FOLDER = Path(__file__).parent
_DIGITS = 9  # of places: those that the room's file gives, without what adding them up leaves


@dataclass(frozen=True)
class Plan:
    """What the hand means to do with one handle, as its YAML file says it.

    Attributes:
        gripper_roll: How far the gripper is turned about the approach, rad.
        start: Where the tool tip begins to reach, in the handle's frame, metres.
        opening: How far the hand means to open what the handle moves, rad or m.
        rise: How far the hand rises while it pulls, metres.
        inertia: What it then feels to move, kg m^2 about the hinge or kg.
    """

    gripper_roll: float
    start: Vector
    opening: Positive
    rise: float
    inertia: Positive


@dataclass(frozen=True, eq=False)
class Exercise:
    """A handle in the room, and what the hand makes of it.

    Attributes:
        joint: What moves when the handle is pulled.
        handle: World pose of the closed handle, shape (7,), x along the approach and z up.
        plan: How it is taken and pulled.
        body: Outline of the furniture from above, two opposite corners, metres.
        part: The same of what moves, while it is closed.
    """

    joint: MechanismJoint
    handle: Array
    plan: Plan
    body: Corners
    part: Corners


def load_exercise(name: str) -> Exercise:
    """Return the exercise `door` or `drawer`.

    Raises:
        KinfeasError: If there is no such exercise.
    """
    if name not in EXERCISES:
        raise KinfeasError(f"unknown mechanism {name!r}{no_such(name, EXERCISES)}")
    plan, room = config.load(Plan, _FOLDER / f"{name}.yaml"), read_scene("room")
    pose, one = room.handle_pose(name), room.objects[room.handles[name].object]
    pose[:3] = _vector(pose[:3])
    return Exercise(
        _joint(room, name, plan.inertia),
        pose,
        plan,
        _outline(one, [link for link in one.urdf.links if not moving_joint(one.urdf, link)]),
        # Without the handle, which stands before it.
        _outline(one, [one.urdf.joints[str(room.handles[name].joint)].child]),
    )


def _joint(room: Scene, name: str, inertia: float) -> MechanismJoint:
    handle = room.handles[name]
    one = room.objects[handle.object]
    joint = one.urdf.joints[str(handle.joint)]
    frame = one.link_poses()[joint.child]
    return MechanismJoint(
        kind="slide" if joint.kind == "prismatic" else "hinge",
        origin=_vector(frame[:3]),
        axis=_vector(rotation(frame).apply(joint.axis)),
        limits=(joint.lower, joint.upper),
        inertia=inertia,
        friction=joint.friction,
        damping=joint.damping,
    )


def _outline(one: SceneObject, links: list[str]) -> Corners:
    """Return the bounds of links, made of boxes, from above."""
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    points = np.concatenate(
        [
            shape.pose[:3] + Rotation.from_quat(shape.pose[3:]).apply(corners * shape.size)
            for link, shape in one.shapes()
            if link in links
        ]
    )
    (left, near, _), (right, far, _) = points.min(axis=0).tolist(), points.max(axis=0).tolist()
    return (left, near), (right, far)


def _vector(values: Array) -> Vector:
    x, y, z = (round(value, _DIGITS) + 0.0 for value in values.tolist())
    return x, y, z
