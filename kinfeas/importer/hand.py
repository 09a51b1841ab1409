"""How a hand is made: its fingers, where they point, and where they meet."""

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from kinfeas.core.spatial import Array, relative, rotation
from kinfeas.importer.arm import Arm, aside
from kinfeas.importer.placed import Placed, link_pose, place
from kinfeas.robots.spec import Gripper
from kinfeas.robots.urdf import Joint, Urdf

_PAIR = 2
_NOTHING = 1e-6  # m
_MOST_EFFORT = 1e4
"""N or N m: more than that stands for none."""


@dataclass(frozen=True, eq=False)
class Hand:
    """What a robot's YAML says of its hand.

    Attributes:
        tip: Between the ends of the fingers, in the hand's frame, shape (3,), metres.
        rotation: Quaternion xyzw (4,), from the common gripper convention to that frame.
        gripper: How it closes; None if there are not two fingers with one range of positions.
    """

    tip: Array
    rotation: Array
    gripper: Gripper | None


def read_hand(urdf: Urdf, arm: Arm) -> Hand:
    """Return what the shapes and fingers of a hand say: axes are those of its frame, the nearest.

    It approaches along the way from the last joint of the arm to the fingers, or to the farthest
    shape of a hand with fewer than two; fingers lie farthest apart along the other axis.
    """
    fingers = arm.fingers if len(arm.fingers) == _PAIR else ()
    closed, opened = _ends(urdf, arm, fingers)
    shapes = _hand_shapes(urdf, arm)
    wrist = relative(
        link_pose(urdf, arm.joints[-1].child, {}), link_pose(urdf, arm.hand, {})
    )[:3]  # fmt: skip
    at = np.array([_middle(urdf, arm, finger, opened) for finger in arm.fingers])
    several = len(at) >= _PAIR
    front = at.mean(axis=0) if several else _farthest(shapes, wrist)
    x = _axis(front - wrist if several else _ahead(urdf, arm, front - wrist))
    across = np.ptp(at, axis=0) if several else _closing(urdf, arm, x)
    beside = across - (across @ x) * x
    if np.linalg.norm(beside) < _NOTHING:
        beside = np.roll(x, 1)
    y = np.abs(_axis(beside))  # either finger may be the first
    reach = max((shape.reach(x) for shape in shapes), default=0.0)
    tip = front - (front @ x) * x + reach * x if several else reach * x
    to_gripper = np.stack([x, y, np.cross(x, y)])
    quaternion = Rotation.from_matrix(to_gripper).as_quat(canonical=True)
    return Hand(tip, quaternion, _gripper(urdf, fingers, closed, opened))


def _ends(
    urdf: Urdf, arm: Arm, fingers: tuple[Joint, ...]
) -> tuple[dict[str, float], dict[str, float]]:
    """Return the positions of the joints that move the fingers, closed and open."""
    leaders = {urdf.followed(finger)[0] for finger in fingers}
    low = {joint.name: max(joint.lower, -math.pi) for joint in leaders}
    high = {joint.name: min(joint.upper, math.pi) for joint in leaders}
    if not fingers:
        return {}, {}

    def gap(positions: dict[str, float]) -> float:
        one, other = (_middle(urdf, arm, finger, positions) for finger in fingers)
        return float(np.linalg.norm(one - other))

    return (low, high) if gap(low) <= gap(high) else (high, low)


def _gripper(
    urdf: Urdf, fingers: tuple[Joint, ...], closed: dict[str, float], opened: dict[str, float]
) -> Gripper | None:
    """Return the fingers as the robot's YAML has them, or None if that has no words for them."""
    if not fingers or any(urdf.followed(finger)[1:] != (1.0, 0.0) for finger in fingers):
        return None
    shut, wide, effort = {*closed.values()}, {*opened.values()}, min(one.effort for one in fingers)
    if len(shut) > 1 or len(wide) > 1 or shut == wide or not 0.0 < effort < _MOST_EFFORT:
        return None
    first, second = (finger.name for finger in fingers)
    return Gripper((first, second), shut.pop(), wide.pop(), effort)


def _middle(urdf: Urdf, arm: Arm, finger: Joint, positions: dict[str, float]) -> Array:
    """Return the middle of a finger's shapes in the hand's frame, shape (3,)."""
    shapes = place(urdf, sorted(urdf.below(finger.name)), arm.hand, positions)
    middle: Array = np.mean([shape.pose[:3] for shape in shapes], axis=0)
    return middle


def _hand_shapes(urdf: Urdf, arm: Arm) -> list[Placed]:
    """Return the shapes of the hand and its fingers in the hand's frame."""
    links = urdf.rigid[arm.hand]
    for finger in arm.fingers:
        links |= urdf.below(finger.name)
    return place(urdf, sorted(links), arm.hand, {})


def _ahead(urdf: Urdf, arm: Arm, reach: Array) -> Array:
    """Return where a hand without fingers points, shape (3,): along `reach`, its farthest shape.

    One that the last joint turns about itself points along that axis, away from what carries it.
    """
    last = arm.joints[-1]
    if last.kind == "prismatic" or aside(urdf, last).any():
        return reach
    axis = rotation(link_pose(urdf, last.child, {})).apply(last.axis)
    carrier = place(urdf, sorted(urdf.rigid[last.parent]), arm.hand, {})
    own = place(urdf, sorted(urdf.rigid[arm.hand]), arm.hand, {})
    axis = rotation(link_pose(urdf, arm.hand, {})).inv().apply(axis)
    way = sum(float(one.pose[:3] @ axis) / len(own) for one in own)
    way -= sum(float(one.pose[:3] @ axis) / len(carrier) for one in carrier)
    ahead: Array = axis if way >= 0.0 else -axis
    return ahead


def _farthest(shapes: list[Placed], wrist: Array) -> Array:
    """Return the middle of the shape that is farthest from the arm's last joint, shape (3,)."""
    return max(
        (shape.pose[:3] for shape in shapes),
        key=lambda middle: np.linalg.norm(middle - wrist),
        default=wrist + np.array([1.0, 0.0, 0.0]),
    )


def _closing(urdf: Urdf, arm: Arm, x: Array) -> Array:
    """Return where a single jaw comes from if the hand approaches along `x`, or 0, shape (3,)."""
    for jaw in arm.fingers:
        seen = relative(link_pose(urdf, jaw.child, {}), link_pose(urdf, arm.hand, {}))
        axis = rotation(seen).apply(jaw.axis)
        return axis if jaw.kind == "prismatic" else np.cross(axis, x)
    return np.zeros(3)


def _axis(direction: Array) -> Array:
    """Return the axis of the frame that is nearest to a direction, either way, shape (3,)."""
    axis = np.zeros(3)
    largest = int(np.argmax(np.abs(direction)))
    axis[largest] = 1.0 if direction[largest] >= 0.0 else -1.0
    return axis
