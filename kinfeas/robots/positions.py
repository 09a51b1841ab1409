"""Where the joints stand that IK does not move."""

from collections.abc import Collection, Mapping

from kinfeas import config
from kinfeas.core.errors import KinfeasError
from kinfeas.robots.tree import Joint, Urdf


def fixed_positions(
    urdf: Urdf, arm: Collection[str], given: Mapping[str, float], source: str
) -> dict[str, float]:
    """Return the position of every joint that moves but does not depend on the arm.

    Args:
        urdf: The robot.
        arm: Names of the arm's joints.
        given: Positions by joint; other joints follow another one or are as near 0 as they can.
        source: File name for the error.

    Raises:
        KinfeasError: If `given` names an unknown joint or one that is not free to be set, or a
            position beyond the hard limits.
    """
    for name, position in given.items():
        _check_given(urdf, arm, name, position, f"{source}: 'fixed_joints.{name}'")
    return {
        joint.name: _position(urdf, joint, given)
        for joint in urdf.joints.values()
        if joint.moves and urdf.followed(joint)[0].name not in arm
    }


def _check_given(urdf: Urdf, arm: Collection[str], name: str, position: float, where: str) -> None:
    if name not in urdf.joints:
        raise KinfeasError(f"{where}: there is no such joint{config.no_such(name, urdf.joints)}")
    joint = urdf.joints[name]
    if name in arm:
        raise KinfeasError(f"{where}: the joint stands in 'arm', too")
    if not joint.moves:
        raise KinfeasError(f"{where}: the joint does not move")
    if joint.mimic is not None:
        raise KinfeasError(f"{where}: the joint follows {joint.mimic.joint!r}, set that one")
    if not joint.lower <= position <= joint.upper:
        allowed = f"{joint.lower:g} to {joint.upper:g}"
        raise KinfeasError(f"{where}: {position:g} is beyond the limits {allowed}")


def _position(urdf: Urdf, joint: Joint, given: Mapping[str, float]) -> float:
    leader, scale, offset = urdf.followed(joint)
    return scale * given.get(leader.name, min(max(0.0, leader.lower), leader.upper)) + offset
