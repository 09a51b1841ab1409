"""What the robot runs into."""

from collections.abc import Collection
from dataclasses import dataclass

from kinfeas.backends.pybullet.robot_body import RobotBody


@dataclass(frozen=True)
class Contacts:
    """How many links of the world touch the robot now, each counted once for each of its links.

    Attributes:
        base: Those that touch what the arm does not carry.
        arm: Those that touch the arm and its hand.
    """

    base: int
    arm: int


@dataclass(frozen=True)
class Touched:
    """Which bodies of the world touch the robot now, by PyBullet's numbers.

    Attributes:
        base: Those that touch what the arm does not carry.
        arm: Those that touch the arm and its hand.
    """

    base: frozenset[int]
    arm: frozenset[int]


def contacts(body: RobotBody, handled: Collection[tuple[int, int]] = ()) -> Contacts:
    """Return what the robot touches, but for the `handled` links: numbers of body and link.

    The robot's own links, and the floor below its base, do not count.
    """
    touching = _touching(body, handled)
    arm = sum(link in body.arm_links for link, _, _ in touching)
    return Contacts(base=len(touching) - arm, arm=arm)


def touched(body: RobotBody, handled: Collection[tuple[int, int]] = ()) -> Touched:
    """Return the bodies that the robot touches; what counts is as for `contacts`."""
    touching = _touching(body, handled)
    arm = frozenset(other for link, other, _ in touching if link in body.arm_links)
    base = frozenset(other for link, other, _ in touching if link not in body.arm_links)
    return Touched(base, arm)


def _touching(
    body: RobotBody, handled: Collection[tuple[int, int]]
) -> frozenset[tuple[int, int, int]]:
    """Return each contact once: the robot's link, the other body and its link."""
    points = body.physics.client.getContactPoints(bodyA=body.body)
    return frozenset(
        (point[3], point[2], point[4])
        for point in points
        if point[8] <= 0.0 and point[2] != body.body and (point[2], point[4]) not in handled
    )
