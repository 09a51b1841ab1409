"""Which link of a URDF is the hand, and which joints lead to it."""

from dataclasses import dataclass

from kinfeas.config import no_such
from kinfeas.errors import KinfeasError
from kinfeas.robots.urdf import Joint, Urdf

_LEAST = 3
"""Joints that an arm has at least: a hand is not looked for nearer to the base."""


@dataclass(frozen=True)
class Arm:
    """What IK moves, and what it places.

    Attributes:
        hand: The link that carries the fingers, or the last one of an arm without.
        joints: Joints that move by themselves, from the root to the hand.
        fingers: Joints right at the hand whose links have collision shapes.
    """

    hand: str
    joints: tuple[Joint, ...]
    fingers: tuple[Joint, ...]


def find_arm(urdf: Urdf, hand: str | None, source: str) -> Arm:
    """Return the arm of a robot.

    A hand is where the longest way of moving joints branches last, into fingers.

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
    joints = tuple(joint for joint in urdf.path_to(hand) if joint.moves and joint.mimic is None)
    if not joints:
        raise KinfeasError(f"{source}: no joint moves between {urdf.root!r} and {hand!r}")
    group = rigid_with(urdf, hand)
    fingers = tuple(
        joint
        for joint in urdf.joints.values()
        if joint.moves
        and joint.parent in group
        and any(urdf.links[link].shapes for link in urdf.below(joint.name))
        and joint not in urdf.path_to(hand)
    )
    return Arm(hand, joints, fingers)


def rigid_with(urdf: Urdf, link: str) -> frozenset[str]:
    """Return the links that cannot move against `link`, itself included."""
    group, grown = {link}, True
    while grown:
        fixed = (joint for joint in urdf.joints.values() if not joint.moves)
        more = {end for one in fixed for end in (one.parent, one.child) if _touches(one, group)}
        grown = not more <= group
        group |= more
    return frozenset(group)


def _touches(joint: Joint, group: set[str]) -> bool:
    return joint.parent in group or joint.child in group


def _find_hand(urdf: Urdf, source: str) -> str:
    ways = {link: [j for j in urdf.path_to(link) if j.moves] for link in urdf.links}
    longest = max(map(len, ways.values()))
    if longest < _LEAST:
        raise KinfeasError(f"{source}: no link has {_LEAST} moving joints above it: no arm")
    hands = list(
        dict.fromkeys(_hand_of(urdf, link) for link, way in ways.items() if len(way) == longest)
    )
    if len(hands) > 1:
        raise KinfeasError(
            f"{source}: there are several arms: choose the link that IK is to place, such as "
            f"{' or '.join(hands)}"
        )
    return hands[0]


def _hand_of(urdf: Urdf, tip: str) -> str:
    """Return the hand to which the link `tip`, the end of a finger or of an arm, belongs."""
    moving = [joint for joint in urdf.path_to(tip) if joint.moves]
    for joint in reversed(moving[_LEAST:]):
        group = rigid_with(urdf, joint.parent)
        branches = [one for one in urdf.joints.values() if one.moves and one.parent in group]
        if len(branches) > 1:
            return joint.parent
    return _end(urdf, moving[-1].child)


def _end(urdf: Urdf, link: str) -> str:
    """Return the last link of those that hang on `link` rigidly, one after the other."""
    while True:
        on = [joint.child for joint in urdf.joints.values() if joint.parent == link]
        if len(on) != 1:
            return link
        (link,) = on
