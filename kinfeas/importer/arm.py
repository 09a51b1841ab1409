"""Which link of a URDF is the hand, and which joints lead to it."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from kinfeas.core.errors import KinfeasError, no_such
from kinfeas.core.spatial import IDENTITY, Array, compose, relative, rotation
from kinfeas.robots.spec import Gripper
from kinfeas.robots.urdf import Joint, Shape, Urdf


class Placed(NamedTuple):
    """A shape and the pose of its centre, shape (7,), metres, in the frame that was asked for."""

    shape: Shape
    pose: Array

    def reach(self, direction: Array) -> float:
        """Return how far the shape goes in a direction, a unit vector (3,), metres."""
        along = rotation(self.pose).inv().apply(direction)
        middle, size = float(self.pose[:3] @ direction), self.shape.size
        if self.shape.kind == "box":
            return middle + float(np.abs(along) @ np.array(size)) / 2.0
        if self.shape.kind == "cylinder":
            radius, length = size
            return middle + radius * float(np.hypot(*along[:2])) + abs(along[2]) * length / 2.0
        return middle + size[0]


def place(
    urdf: Urdf, links: Iterable[str], frame: str, positions: Mapping[str, float]
) -> list[Placed]:
    """Return the shapes of some links.

    Args:
        urdf: The robot.
        links: Names of the links.
        frame: The link that they are seen from.
        positions: Of joints that follow no other, rad or m; the rest are as near 0 as they can.
    """
    at = link_pose(urdf, frame, positions)
    return [
        Placed(shape, relative(compose(link_pose(urdf, link, positions), shape.pose), at))
        for link in links
        for shape in urdf.links[link].shapes
    ]


def link_pose(urdf: Urdf, link: str, positions: Mapping[str, float]) -> Array:
    """Return the pose of a link seen from the root, shape (7,); positions as above."""
    pose = IDENTITY
    for joint in urdf.path_to(link):
        leader, scale, offset = urdf.followed(joint)
        rest = min(max(0.0, leader.lower), leader.upper)
        pose = compose(pose, joint.pose_at(scale * positions.get(leader.name, rest) + offset))
    return pose


_LEAST = 3
"""Joints that an arm has at least: a hand is not looked for nearer to the base."""

_BESIDE = 1.0 / 3.0
"""Share of a jaw's length beyond which what carries it goes on: a link ends at its next joint."""

_PLAY = 0.01  # m, by which shapes about an axis may be off it


@dataclass(frozen=True)
class Arm:
    """What IK moves, and what it places.

    Attributes:
        hand: The link that carries the fingers, or the last one of an arm without.
        joints: Joints that move by themselves, from the root to the hand.
        stuck: Joints on the way that would, but have limits that leave them no room.
        fingers: Joints right at the hand whose links have collision shapes.
    """

    hand: str
    joints: tuple[Joint, ...]
    stuck: tuple[Joint, ...]
    fingers: tuple[Joint, ...]


def find_arm(urdf: Urdf, hand: str | None, source: str) -> Arm:
    """Return the arm of a robot.

    A hand is where the longest way of moving joints branches last, into fingers, or what a single
    jaw closes on.

    Args:
        urdf: The robot.
        hand: The link that IK is to place; it is looked for by default.
        source: File name for errors.

    Raises:
        KinfeasError: If there is no such link, no arm, or more than one that could be meant.
    """
    if hand is None:
        hand = _find_hand(urdf, source)
    if hand not in urdf.links:
        raise KinfeasError(f"{source}: there is no link {hand!r}{no_such(hand, urdf.links)}")
    own = [joint for joint in urdf.path_to(hand) if joint.moves and joint.mimic is None]
    joints = tuple(joint for joint in own if joint.soft_lower < joint.soft_upper)
    if not joints:
        raise KinfeasError(f"{source}: no joint moves between {urdf.root!r} and {hand!r}")
    group = urdf.rigid[hand]
    fingers = tuple(
        joint
        for joint in urdf.joints.values()
        if joint.moves
        and joint.parent in group
        and any(urdf.links[link].shapes for link in urdf.below(joint.name))
    )
    return Arm(hand, joints, tuple(joint for joint in own if joint not in joints), fingers)


def bare_stand(urdf: Urdf, arm: Arm) -> str:
    """Return the link that an arm is on, if nothing tells it from the arm's own first link.

    Nothing does if all that stands still below the arm is a single body, and nothing else moves
    on it, such as wheels or a head. An arm that begins with a slide has a lift, and so a base.
    The name is empty if something does.
    """
    first = arm.joints[0]
    group = urdf.rigid[first.parent]
    moving = [joint for link in group for joint in urdf.on[link] if joint.moves]
    bodies = [link for link in group if urdf.links[link].shapes]
    bare = len(moving) == len(bodies) == 1 and first.kind != "prismatic"
    return bodies[0] if bare else ""


def _find_hand(urdf: Urdf, source: str) -> str:
    ways = {link: [j for j in urdf.path_to(link) if j.moves] for link in urdf.links}
    longest = max(map(len, ways.values()))
    if longest < _LEAST:
        raise KinfeasError(f"{source}: no link has {_LEAST} moving joints above it: no arm")
    on_body: dict[frozenset[str], list[str]] = {}
    for joint in urdf.joints.values():
        if joint.moves:
            on_body.setdefault(urdf.rigid[joint.parent], []).append(joint.parent)
    forks = {body: _shared(urdf, links) for body, links in on_body.items() if len(links) > 1}
    arms = {way[-1].name: way for way in ways.values() if len(way) == longest}
    hands = list(dict.fromkeys(_hand_of(urdf, way, forks) for way in arms.values()))
    if len(hands) > 1:
        raise KinfeasError(
            f"{source}: there are several arms: choose the link that IK is to place, such as "
            f"{' or '.join(hands)}"
        )
    return hands[0]


def _hand_of(urdf: Urdf, moving: list[Joint], forks: dict[frozenset[str], str]) -> str:
    """Return the hand to which the end of a finger or of an arm belongs.

    Args:
        urdf: The robot.
        moving: Joints that lead to the end.
        forks: Of rigid links on which several joints are, the last one on the way to all of these.
    """
    for joint in reversed(moving[_LEAST:]):
        if hand := forks.get(urdf.rigid[joint.parent]):
            return hand
    if len(moving) > _LEAST and _is_jaw(urdf, moving[-1]):
        return moving[-1].parent
    return _end(urdf, moving[-1].child)


def _shared(urdf: Urdf, links: list[str]) -> str:
    """Return the last link that is on the way to all of `links`, or one of them."""
    ways = [[urdf.root, *(joint.child for joint in urdf.path_to(link))] for link in links]
    return [level[0] for level in zip(*ways, strict=False) if len(set(level)) == 1][-1]


def aside(urdf: Urdf, joint: Joint) -> Array:
    """Return where the shapes are that a joint moves, as seen from its axis, shape (3,), metres.

    The frame is that of its child. Zero stands for a joint that turns them about themselves, as
    that of a wrist does, or slides them along their own length.
    """
    shapes = place(urdf, sorted(urdf.below(joint.name)), joint.child, {})
    if not shapes:
        return np.zeros(3)
    middle = np.mean([shape.pose[:3] for shape in shapes], axis=0)
    along = float(middle @ joint.axis)
    away: Array = middle - along * np.array(joint.axis)
    return away if np.linalg.norm(away) > abs(along) + _PLAY else np.zeros(3)


def _is_jaw(urdf: Urdf, joint: Joint) -> bool:
    """Return whether what a joint moves lies beside what carries it: it closes on a fixed jaw."""
    away = aside(urdf, joint)
    if not away.any():
        return False
    direction = away / np.linalg.norm(away)
    sides = urdf.below(joint.name), urdf.rigid[joint.parent]
    jaw, beside = (
        max((one.reach(direction) for one in place(urdf, sorted(side), joint.child, {})), default=0)
        for side in sides
    )
    return beside > _BESIDE * jaw


def _end(urdf: Urdf, link: str) -> str:
    """Return the last link of those that hang on `link` rigidly, one after the other."""
    while len(urdf.on[link]) == 1:
        link = urdf.on[link][0].child
    return link


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
