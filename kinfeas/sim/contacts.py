"""What the robot runs into."""

from collections.abc import Collection
from dataclasses import dataclass

from kinfeas.sim.robot_body import RobotBody


@dataclass(frozen=True)
class Contacts:
    """How many links of the world touch the robot now, each counted once for each of its links.

    Attributes:
        base: Those that touch what the arm does not carry.
        arm: Those that touch the arm and its hand.
    """

    base: int
    arm: int


def contacts(body: RobotBody, handled: Collection[tuple[int, int]] = ()) -> Contacts:
    """Return what the robot touches, but for the `handled` links: numbers of body and link.

    The robot's own links, and the floor below its base, do not count.
    """
    points = body.physics.client.getContactPoints(bodyA=body.body)
    touching = {
        (point[3], point[2], point[4])
        for point in points
        if point[8] <= 0.0 and point[2] != body.body and (point[2], point[4]) not in handled
    }
    arm = sum(link in body.arm_links for link, _, _ in touching)
    return Contacts(base=len(touching) - arm, arm=arm)
