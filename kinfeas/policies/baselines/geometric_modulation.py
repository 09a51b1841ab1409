"""Geometric modulation: the base keeps between two ellipses around the EE.

After Welschehold et al., "Coupling mobile base and end-effector motion in task space" (IROS 2018),
with ellipses fitted to the robot's own reach. The EE's motion is what it is; the base copies its
velocity, is led around the ellipses where it would cross them, and turns to have the EE before it.
"""

from dataclasses import dataclass

import numpy as np

from kinfeas.control.drive import action_toward
from kinfeas.control.observation import HORIZON
from kinfeas.core.policy import PolicyInput
from kinfeas.core.spatial import Array, wrap, yaw
from kinfeas.policies.baselines.reach_ellipses import ReachEllipses, approach, fit_ellipses, turned
from kinfeas.robots.robot import Robot

_RHO_INNER, _RHO_OUTER = 1.9, 0.1
_PUSH, _FULL_PUSH = 0.1, 0.1
"""Speed, m/s, toward the allowed side, and how far the level lies below 1 where it is reached."""

_CONE, _HEADING_GAIN = 0.15, 1.0
"""Half angle, radians, in which the heading is free, and rad/s per radian beyond."""

_AHEAD = 0.6
"""Metres ahead of a differential base at which a point can move in every direction."""

_TINY = 1e-6


@dataclass(frozen=True, eq=False)
class GeometricModulation:
    """Drives as the EE moves, within reach of it.

    The velocity is measured from the achieved EE position to the planned one, so that the base
    also closes the arm's error. An omnidirectional base copies the modulated velocity and turns
    freely. A differential one moves as if the velocity were that of a point ahead of it, and turns
    for the bearing besides.

    Attributes:
        robot: Who moves.
        ellipses: Where its base should stand.
    """

    robot: Robot
    ellipses: ReachEllipses

    def act(self, policy_input: PolicyInput) -> Array:
        """Return base commands in [-1, 1], shape (n, 3) or (n, 2)."""
        base, ee = self.robot.base, policy_input.ee_pose
        offset = policy_input.base_pose[:, :2] - ee[:, :2]
        velocity = (policy_input.planned[:, :2] - ee[:, :2]) / HORIZON
        velocity = velocity + self._correction(ee, policy_input.planned, offset)
        heading = yaw(policy_input.base_pose)
        off = wrap(np.arctan2(-offset[:, 1], -offset[:, 0]) - heading - self.ellipses.bearing)
        turn = _HEADING_GAIN * np.sign(off) * np.maximum(np.abs(off) - _CONE, 0.0)
        if base.drive == "omnidirectional":
            action = action_toward(base, policy_input.base_pose, velocity, HORIZON)
            action[:, 2] = turn / base.max_rotation
        else:
            seen = turned(velocity, -heading)
            turn = turn + seen[:, 1] / _AHEAD
            action = np.stack([seen[:, 0] / base.max_velocity, turn / base.max_rotation], axis=1)
        return np.clip(action, -1.0, 1.0)

    def _correction(self, ee: Array, planned: Array, offset: Array) -> Array:
        """Return what the ellipses add to the EE's velocity, world axes, shape (n, 2), m/s.

        They turn with the azimuth of the approach, so that a base that only moves as the EE does
        drifts through them.
        """
        pitch, azimuth = approach(self.robot, ee)
        _, later = approach(self.robot, planned)
        # Where the approach is all but vertical its azimuth spins, and the ellipses are round.
        spin = np.where(np.cos(pitch) > 0.1, wrap(later - azimuth), 0.0)
        place = turned(offset, -azimuth)
        drift = (turned(offset, -azimuth - spin) - place) / HORIZON
        shape = self.ellipses.at(ee[:, 2], pitch)
        return turned(modulated(place, drift, shape) - drift, azimuth)


def geometric_modulation(robot: Robot) -> GeometricModulation:
    """Return the policy for a robot; fitting its ellipses takes about two seconds."""
    return GeometricModulation(robot, fit_ellipses(robot))


def modulated(place: Array, velocity: Array, shape: Array) -> Array:
    """Return a velocity that does not leave the ring between two ellipses, and leads back into it.

    Welschehold et al. (2018): along the normal of a boundary that is approached, the velocity is
    scaled by `1 - w / level^(1/rho)`, along its tangent by `1 + w / level^(1/rho)`.

    Args:
        place: Position in the frame of the ellipses, shape (n, 2), metres.
        velocity: Relative to them, shape (n, 2), m/s.
        shape: As `ReachEllipses.shapes`, shape (n, 6).
    """
    level_in, normal_in = _boundary(place, shape[:, 4:6])
    level_out, normal_out = _boundary(place - shape[:, :2], shape[:, 2:4])
    level_out, normal_out = 1.0 / level_out, -normal_out
    above_in, above_out = np.maximum(level_in - 1.0, _TINY), np.maximum(level_out - 1.0, _TINY)
    weight_in = above_out / (above_in + above_out)
    velocity = _led_around(velocity, normal_in, weight_in * _decay(level_in, _RHO_INNER))
    velocity = _led_around(velocity, normal_out, (1.0 - weight_in) * _decay(level_out, _RHO_OUTER))
    return velocity + _push(level_in) * normal_in + _push(level_out) * normal_out


def _boundary(place: Array, axes: Array) -> tuple[Array, Array]:
    """Return the level of an ellipse, 1 on it and more outside, (n, 1), and its normal, (n, 2)."""
    scaled = place / axes
    level = scaled[:, :1] ** 2 + scaled[:, 1:] ** 2
    normal = scaled / axes
    length = np.sqrt(normal[:, :1] ** 2 + normal[:, 1:] ** 2)
    return np.maximum(level, _TINY), normal / np.maximum(length, _TINY)


def _decay(level: Array, rho: float) -> Array:
    return np.maximum(level, 1.0) ** (-1.0 / rho)


def _led_around(velocity: Array, normal: Array, strength: Array) -> Array:
    """Return the velocity with less of it toward a boundary and more of it along it."""
    along_normal = velocity[:, :1] * normal[:, :1] + velocity[:, 1:] * normal[:, 1:]
    toward = along_normal * normal
    strength = np.where(along_normal < 0.0, strength, 0.0)
    return (1.0 - strength) * toward + (1.0 + strength) * (velocity - toward)


def _push(level: Array) -> Array:
    return _PUSH * np.clip((1.0 - level) / _FULL_PUSH, 0.0, 1.0)
