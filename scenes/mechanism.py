"""Doors and drawers: one joint with friction between the furniture and a handle that is pulled."""

from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from kinfeas.config.quantities import NotNegative, Positive, Vector
from kinfeas.core.spatial import Array, compose


class Mechanism(Protocol):
    """Furniture with a handle; what pulls it feels how far the handle gives way."""

    def handle_pose(self) -> Array:
        """Return where the handle is now, world pose of shape (7,)."""
        ...

    def pull(self, force: Array, point: Array, dt: float) -> None:
        """Let `force` act at `point`, both (3,) in N and m in the world, for `dt` seconds."""
        ...


@dataclass(frozen=True)
class MechanismJoint:
    """A hinge or a slide.

    Attributes:
        kind: What the joint is.
        origin: A point on a hinge's axis, in metres; of no meaning to a slide.
        axis: Unit vector of the turn or the motion that opens.
        limits: Least and greatest position, rad or m; zero is closed.
        inertia: What is moved, kg m^2 about the axis or kg.
        friction: What a motion must overcome, N m or N.
        damping: Resistance per velocity, N m s/rad or N s/m.
    """

    kind: Literal["hinge", "slide"]
    origin: Vector
    axis: Vector
    limits: tuple[float, float]
    inertia: Positive
    friction: NotNegative
    damping: NotNegative

    def __post_init__(self) -> None:
        """Check what the types cannot say."""
        if not self.limits[0] <= 0.0 < self.limits[1]:
            raise ValueError("'limits' must go from at most 0, closed, to above 0")
        if abs(np.linalg.norm(self.axis) - 1.0) > 1e-6:
            raise ValueError("'axis' must be a unit vector")

    def carry(self, pose: Array, position: Array | float) -> Array:
        """Return where the joint takes what is at `pose` while it is closed.

        Args:
            pose: World pose, shape (7,).
            position: Joint positions, rad or m, shape (...).

        Returns:
            World poses, shape (..., 7).
        """
        opening = np.asarray(position)[..., np.newaxis]
        moved = np.zeros((*np.shape(position), 7))
        moved[..., 6] = 1.0
        if self.kind == "slide":
            moved[..., :3] = opening * self.axis
            return compose(moved, pose)
        moved[..., :3] = self.origin
        moved[..., 3:6] = np.sin(opening / 2.0) * self.axis
        moved[..., 6:] = np.cos(opening / 2.0)
        from_origin = pose.copy()
        from_origin[:3] -= self.origin
        return compose(moved, from_origin)

    def effort(self, force: Array, point: Array) -> float:
        """Return the torque or force along the joint of a `force` (3,) at `point` (3,)."""
        moment = force if self.kind == "slide" else np.cross(point - self.origin, force)
        return float(np.dot(self.axis, moment))


class AnalyticMechanism:
    """A joint alone, integrated step by step; it begins closed and at rest.

    Args:
        joint: What moves.
        handle: Pose of the handle while closed, world, shape (7,).
    """

    def __init__(self, joint: MechanismJoint, handle: Array) -> None:
        self._joint, self._handle = joint, handle
        self.position = 0.0
        self._velocity = 0.0

    def handle_pose(self) -> Array:
        """Return where the handle is now, world pose of shape (7,)."""
        return self._joint.carry(self._handle, self.position)

    def pull(self, force: Array, point: Array, dt: float) -> None:
        """Let `force` act at `point`, both (3,) in N and m in the world, for `dt` seconds."""
        joint = self._joint
        effort = joint.effort(force, point) - joint.damping * self._velocity
        velocity = self._velocity + dt * effort / joint.inertia
        # Friction takes velocity away and never turns it round.
        lost = min(abs(velocity), dt * joint.friction / joint.inertia)
        velocity -= float(np.copysign(lost, velocity))
        position = self.position + dt * velocity
        self.position = min(max(position, joint.limits[0]), joint.limits[1])
        self._velocity = velocity if self.position == position else 0.0
