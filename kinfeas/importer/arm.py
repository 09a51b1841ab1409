"""The arm and the hand of a URDF: joints, fingers, tool tip, gripper axes."""

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from kinfeas.core.errors import KinfeasError, no_such
from kinfeas.core.spatial import Array, compose, relative, rotation
from kinfeas.robots.spec import GripperSpec
from kinfeas.robots.urdf import Joint, Shape, Urdf

_MIN_JOINTS = 3
"""Least number of joints of an arm; a branch nearer to the base is no hand."""

_FIXED_JAW = 1.0 / 3.0
"""Least length of a fixed jaw, as a fraction of the length of the moving one."""

_JAW = re.compile(r"jaw|finger|claw", re.IGNORECASE)
_PAD = 0.025  # m, from the ends of fingers to where they hold an object
_OFF_AXIS = 0.01  # m, by which shapes on an axis may be off it
_NOTHING = 1e-6  # m, length that counts as 0
_MAX_EFFORT = 1e4  # N or N m; larger limits stand for none
_GUESSED_EFFORT = {"prismatic": 20.0, "revolute": 2.0, "continuous": 2.0}  # N or N m, of a finger


def place(urdf: Urdf, links: Iterable[str], frame: str, poses: Mapping[str, Array]) -> list[Shape]:
    """Return the shapes of some links with their poses in the link `frame`.

    `poses` are those of all links, from `Urdf.link_poses`.
    """
    return [
        replace(shape, pose=relative(compose(poses[link], shape.pose), poses[frame]))
        for link in links
        for shape in urdf.links[link].shapes
    ]


def axis_in_root(urdf: Urdf, joint: Joint) -> Array:
    """Return the axis of a joint in the frame of the root, all joints at rest, shape (3,)."""
    return rotation(urdf.link_poses({})[joint.child]).apply(joint.axis)


@dataclass(frozen=True)
class Arm:
    """The arm of a robot."""

    hand: str  # link that carries the fingers; without fingers the last link
    joints: tuple[Joint, ...]  # from the root to the hand, without fixed and mimic joints
    stuck: tuple[Joint, ...]  # joints on that path whose limits leave no range of motion
    # joints on the hand whose links have collision shapes; if none have, those that slide
    fingers: tuple[Joint, ...]


def find_arm(urdf: Urdf, hand: str | None, source: str) -> Arm:
    """Return the arm of a robot.

    IK places the link `hand`. By default this is the last link at which the longest chain of moving
    joints branches into fingers, or the link with a fixed jaw on which a single finger closes.
    """
    if hand is None:
        hand, *others = dict.fromkeys(_hands(urdf, source).values())
        if others:
            raise KinfeasError(
                f"{source}: there are several arms: choose the link that IK places, such as "
                f"--ee {' or '.join([hand, *others])}"
            )
    if hand not in urdf.links:
        raise KinfeasError(f"{source}: there is no link {hand!r}{no_such(hand, urdf.links)}")
    on_path = [joint for joint in urdf.path_to(hand) if joint.moves and joint.mimic is None]
    joints = tuple(joint for joint in on_path if joint.soft_lower < joint.soft_upper)
    if not joints:
        raise KinfeasError(f"{source}: no joint moves between {urdf.root!r} and {hand!r}")
    on_hand, links = _on_hand(urdf, hand), urdf.links
    shaped = [j for j in on_hand if any(links[name].shapes for name in urdf.below(j.name))]
    # The frames of fingers without shapes show how far apart these are, if they slide.
    fingers = tuple(shaped or [joint for joint in on_hand if joint.kind == "prismatic"])
    return Arm(hand, joints, tuple(joint for joint in on_path if joint not in joints), fingers)


def _on_hand(urdf: Urdf, hand: str) -> list[Joint]:
    return [
        joint for joint in urdf.joints.values() if joint.moves and joint.parent in urdf.rigid[hand]
    ]


def ends_of_arms(urdf: Urdf, source: str) -> frozenset[str]:
    """Return the links whose shapes decide where the hands of several arms are; none for one arm.

    Errors are as in `find_arm`, which needs these shapes.
    """
    hands = _hands(urdf, source)
    if len(set(hands.values())) == 1:
        return frozenset()
    lasts = [urdf.joints[name] for name in hands]
    return frozenset[str]().union(
        *(urdf.below(last.name) | urdf.rigid[last.parent] for last in lasts)
    )


def _hands(urdf: Urdf, source: str) -> dict[str, str]:
    """Return the hands of the longest chains of moving joints, by the name of the last joint."""
    paths = {link: [j for j in urdf.path_to(link) if j.moves] for link in urdf.links}
    longest = max(map(len, paths.values()))
    if longest < _MIN_JOINTS:
        raise KinfeasError(f"{source}: no arm: no link has {_MIN_JOINTS} moving joints above it")
    branches: dict[frozenset[str], list[str]] = {}
    for joint in urdf.joints.values():
        if joint.moves:
            branches.setdefault(urdf.rigid[joint.parent], []).append(joint.parent)
    forks = {body: _last_common(urdf, links) for body, links in branches.items() if len(links) > 1}
    arms = {path[-1].name: path for path in paths.values() if len(path) == longest}
    return {last: _hand_of(urdf, path, forks) for last, path in arms.items()}


def _hand_of(urdf: Urdf, moving: list[Joint], forks: dict[frozenset[str], str]) -> str:
    """Return the hand of a chain of moving joints; `forks` has the link where a group branches."""
    for joint in reversed(moving[_MIN_JOINTS:]):
        if hand := forks.get(urdf.rigid[joint.parent]):
            return hand
    if len(moving) > _MIN_JOINTS and _is_jaw(urdf, moving[-1]):
        return moving[-1].parent
    link = moving[-1].child
    while len(urdf.on[link]) == 1:
        link = urdf.on[link][0].child
    return link


def _last_common(urdf: Urdf, links: list[str]) -> str:
    """Return the last link that is on the paths from the root to all of `links`, inclusive."""
    paths = [[urdf.root, *(joint.child for joint in urdf.path_to(link))] for link in links]
    return [level[0] for level in zip(*paths, strict=False) if len(set(level)) == 1][-1]


def _is_jaw(urdf: Urdf, joint: Joint) -> bool:
    """Return whether a joint closes on a fixed jaw: its parent has a shape beside its child's.

    Without shapes, the names decide.
    """
    if not any(urdf.links[link].shapes for link in urdf.below(joint.name)):
        return _JAW.search(joint.name + joint.child) is not None
    offset = _off_axis(urdf, joint)
    if not offset.any():
        return False
    direction, poses = offset / np.linalg.norm(offset), urdf.link_poses({})

    def reach(links: frozenset[str]) -> float:
        shapes = place(urdf, sorted(links), joint.child, poses)
        return max((shape.reach(direction) for shape in shapes), default=0.0)

    return reach(urdf.rigid[joint.parent]) > _FIXED_JAW * reach(urdf.below(joint.name))


def _off_axis(urdf: Urdf, joint: Joint) -> Array:
    """Return the offset from a joint's axis to the shapes that it moves, shape (3,), metres.

    It is in the child's frame, and zero if the shapes are on the axis, as at a wrist.
    """
    shapes = place(urdf, sorted(urdf.below(joint.name)), joint.child, urdf.link_poses({}))
    if not shapes:
        return np.zeros(3)
    middle = np.mean([shape.pose[:3] for shape in shapes], axis=0)
    along = float(middle @ joint.axis)
    offset: Array = middle - along * np.array(joint.axis)
    return offset if np.linalg.norm(offset) > abs(along) + _OFF_AXIS else np.zeros(3)


@dataclass(frozen=True, eq=False)
class Hand:
    """The tool tip (3,), metres, in the hand's frame, and the `gripper_rotation` of `RobotSpec`.

    `gripper` is None without two fingers that open and close; `no_gripper` is the reason.
    """

    tip: Array
    rotation: Array
    gripper: GripperSpec | None
    no_gripper: str = ""


def read_hand(urdf: Urdf, arm: Arm) -> Hand:
    """Return the hand of an arm; its approach and finger axes are axes of its frame.

    The approach leads from the last joint of the arm to the fingers, or to the farthest shape of a
    hand with fewer than two. The fingers are farthest apart along the finger axis.
    """
    fingers = arm.fingers if len(arm.fingers) == 2 else ()
    closed, opened = _finger_positions(urdf, arm, fingers)
    links = urdf.rigid[arm.hand].union(*(urdf.below(finger.name) for finger in arm.fingers))
    poses, open_poses = urdf.link_poses({}), urdf.link_poses(opened)
    shapes = place(urdf, sorted(links), arm.hand, poses)
    wrist = relative(poses[arm.joints[-1].child], poses[arm.hand])[:3]
    middles = np.array([_middle(urdf, arm, finger, open_poses) for finger in arm.fingers])
    several = len(middles) > 1
    front = middles.mean(axis=0) if several else _farthest(shapes, wrist)
    x = _nearest_axis(front - wrist if several else _approach(urdf, arm, front - wrist))
    across = np.ptp(middles, axis=0) if several else _closing(urdf, arm, x)
    beside = across - (across @ x) * x
    if np.linalg.norm(beside) < _NOTHING:
        beside = np.roll(x, 1)
    y = np.abs(_nearest_axis(beside))  # either finger may be the first
    reach = max((shape.reach(x) for shape in shapes), default=float(front @ x) * several)
    # Without fingers, a hand frame ahead of all shapes is at the tool tip itself.
    hold = front - (front @ x) * x + (reach - _PAD * bool(shapes)) * x
    tip = hold if several else max(0.0, reach) * x
    to_gripper = np.stack([x, y, np.cross(x, y)])
    quaternion = Rotation.from_matrix(to_gripper).as_quat(canonical=True)
    gripper = _gripper(urdf, arm, closed, opened)
    if isinstance(gripper, str):
        return Hand(tip, quaternion, None, gripper)
    return Hand(tip, quaternion, gripper)


def _finger_positions(
    urdf: Urdf, arm: Arm, fingers: tuple[Joint, ...]
) -> tuple[dict[str, float], dict[str, float]]:
    """Return the positions of the joints that move the fingers, closed and open."""
    if not fingers:
        return {}, {}
    leaders = list({urdf.followed(finger)[0].name: None for finger in fingers})
    joints = [urdf.joints[name] for name in leaders]
    ends = [(max(joint.lower, -math.pi), min(joint.upper, math.pi)) for joint in joints]

    def gap(positions: dict[str, float]) -> float:
        poses = urdf.link_poses(positions)
        first, second = (_middle(urdf, arm, finger, poses) for finger in fingers)
        return float(np.linalg.norm(first - second))

    # Fingers with mirrored limits are closed at the upper limit of one and the lower of the other.
    mirrored = [ends[0], *(end[::-1] for end in ends[1:])]
    choices = [
        [dict(zip(leaders, positions, strict=True)) for positions in zip(*ends_pair, strict=True)]
        for ends_pair in (ends, mirrored)
    ]
    first, second = max(choices, key=lambda pair: abs(gap(pair[0]) - gap(pair[1])))
    return (first, second) if gap(first) <= gap(second) else (second, first)


def _gripper(
    urdf: Urdf, arm: Arm, closed: dict[str, float], opened: dict[str, float]
) -> GripperSpec | str:
    names = [finger.name for finger in arm.fingers]
    if len(names) != 2:
        more = [finger.name for finger in _on_hand(urdf, arm.hand) if finger.name not in names]
        listed = ", ".join([*names, *(f"{name} without shapes" for name in more)]) or "none"
        return f"fingers on {arm.hand!r}: {listed}; two are supported, no four-bar linkages"

    def positions(leaders: dict[str, float]) -> tuple[float, float]:
        first, second = (
            round(min(max(scale * leaders[leader.name] + offset, finger.lower), finger.upper), 6)
            for finger in arm.fingers
            for leader, scale, offset in [urdf.followed(finger)]
        )
        return first, second

    if not any(urdf.links[link].shapes for name in names for link in urdf.below(name)):
        return f"{' and '.join(names)} have no collision shapes to hold an object"
    shut, wide = positions(closed), positions(opened)
    if still := [name for name, *at in zip(names, shut, wide, strict=True) if at[0] == at[1]]:
        return f"the limits of {', '.join(still)} leave no stroke"
    same = shut[0] == shut[1] and wide[0] == wide[1]
    return GripperSpec(
        (names[0], names[1]), closed=shut[0] if same else shut, open=wide[0] if same else wide,
        effort=min(effort_limits(arm.fingers), default=_GUESSED_EFFORT[arm.fingers[0].kind]),
    )  # fmt: skip


def effort_limits(fingers: Iterable[Joint]) -> list[float]:
    """Return the valid effort limits of some joints, N or N m."""
    return [finger.effort for finger in fingers if 0.0 < finger.effort < _MAX_EFFORT]


def _middle(urdf: Urdf, arm: Arm, finger: Joint, poses: Mapping[str, Array]) -> Array:
    """Return a finger's mean shape position, or link position, in the hand's frame, (3,)."""
    shapes = place(urdf, sorted(urdf.below(finger.name)), arm.hand, poses)
    if not shapes:
        return relative(poses[finger.child], poses[arm.hand])[:3]
    return np.mean([shape.pose[:3] for shape in shapes], axis=0)


def _approach(urdf: Urdf, arm: Arm, reach: Array) -> Array:
    """Return the approach of a hand without fingers, shape (3,).

    It is `reach`, the vector to its farthest shape; or, if the last joint turns the hand about its
    own axis, this axis, away from the parent of that joint.
    """
    last = arm.joints[-1]
    if last.kind == "prismatic" or _off_axis(urdf, last).any():
        return reach
    poses = urdf.link_poses({})
    axis = rotation(relative(poses[last.child], poses[arm.hand])).apply(last.axis)
    own = place(urdf, sorted(urdf.rigid[arm.hand]), arm.hand, poses)
    parent = place(urdf, sorted(urdf.rigid[last.parent]), arm.hand, poses)
    ahead = sum(float(shape.pose[:3] @ axis) / len(own) for shape in own)
    ahead -= sum(float(shape.pose[:3] @ axis) / len(parent) for shape in parent)
    return axis if ahead >= 0.0 else -axis


def _farthest(shapes: list[Shape], wrist: Array) -> Array:
    """Return the middle of the shape that is farthest from the wrist, shape (3,)."""
    return max(
        (shape.pose[:3] for shape in shapes),
        key=lambda middle: np.linalg.norm(middle - wrist),
        default=wrist + np.array([1.0, 0.0, 0.0]),
    )


def _closing(urdf: Urdf, arm: Arm, x: Array) -> Array:
    """Return the direction in which a single jaw closes, shape (3,); 0 without a jaw."""
    for jaw in arm.fingers:
        poses = urdf.link_poses({})
        axis = rotation(relative(poses[jaw.child], poses[arm.hand])).apply(jaw.axis)
        return axis if jaw.kind == "prismatic" else np.cross(axis, x)
    return np.zeros(3)


def _nearest_axis(direction: Array) -> Array:
    """Return the signed axis of the frame that is nearest to a direction, shape (3,)."""
    axis = np.zeros(3)
    largest = int(np.argmax(np.abs(direction)))
    axis[largest] = 1.0 if direction[largest] >= 0.0 else -1.0
    return axis
