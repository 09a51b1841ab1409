"""Which link of a URDF is the hand, and which joints lead to it."""

from dataclasses import dataclass

import numpy as np

from kinfeas.config import no_such
from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import Array
from kinfeas.importer.placed import place
from kinfeas.robots.urdf import Joint, Urdf

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
