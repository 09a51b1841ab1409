"""Contacts between the simulated robot and its surroundings."""

from collections.abc import Collection

from kinfeas.backends.pybullet.robot_body import RobotBody
from kinfeas.core.backend import Contacts


def contacts(body: RobotBody, handled: Collection[tuple[int, int]] = ()) -> Contacts:
    """Return the contacts of a robot, except those with `handled` links (body, link).

    The robot's own links, and the floor below its base, do not count.
    """
    points = body.physics.client.getContactPoints(bodyA=body.body)
    touching = frozenset(
        (point[3], point[2], point[4])
        for point in points
        if point[8] <= 0.0 and point[2] != body.body and (point[2], point[4]) not in handled
    )
    arm = frozenset(contact for contact in touching if contact[0] in body.arm_links)
    return Contacts(touching - arm, arm)
