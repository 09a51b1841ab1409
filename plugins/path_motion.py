"""What motions along a path share: where it lies, and how far along it they are."""

import math
from collections.abc import Sequence
from typing import Literal, get_args

import numpy as np

from kinfeas.config import no_such
from kinfeas.core.errors import KinfeasError
from kinfeas.core.motion import State
from kinfeas.core.spatial import IDENTITY, Array, compose, relative, twist_between
from kinfeas.plugins.path import Path
from kinfeas.plugins.phase import PhaseControl

Frame = Literal["object", "goal", "world"]
"""What a path is moved with: the target as the handled object, the target as its end, nothing."""

_FINEST = 0.05  # seconds from knot to knot, if the path is not too long for that
_MOST_SEGMENTS = 20_000


class PathMotion:
    """Motions along one path, in the frame of their targets or in the world.

    The state holds the phase in [0, 1], the share of the path that is behind the hand.
    """

    def __init__(self, control: PhaseControl, in_world: bool) -> None:
        """Follow the path of `control`, which is one in the world or moves with the target."""
        self._control, self._in_world = control, in_world

    def start(
        self, ee_pose: Array, target_pose: Array, rngs: Sequence[np.random.Generator]
    ) -> State:
        """Return the state of n motions.

        Args:
            ee_pose: World pose of the driven frame, shape (n, 7); not used.
            target_pose: World pose that the path moves with, shape (n, 7).
            rngs: Not used.
        """
        return {"phase": np.zeros(len(target_pose))}

    def goal_pose(self, state: State, target_pose: Array) -> Array:
        """Return the world poses at which the motions end, shape (n, 7)."""
        return compose(self._frame(target_pose), self._control.path.knots[-1])

    def twist(
        self, state: State, ee_pose: Array, target_pose: Array, dt: Array
    ) -> tuple[Array, State]:
        """Return the world twist for the next `dt` seconds, shape (n, 6), and the next state.

        Args:
            state: State of n motions.
            ee_pose: World pose that the motion has come to, shape (n, 7).
            target_pose: World pose of the target now, shape (n, 7).
            dt: Duration of each motion's step in seconds, shape (n,).
        """
        frame = self._frame(target_pose)
        twist, phase = self._control.step(frame, state["phase"], ee_pose, dt)
        return twist, {"phase": phase}

    def _frame(self, target_pose: Array) -> Array:
        """Return the world poses of the frames that the path is in, shape (n, 7)."""
        return np.broadcast_to(IDENTITY, target_pose.shape) if self._in_world else target_pose


def checked_frame(name: str) -> Frame:
    """Return the frame of this name.

    Raises:
        KinfeasError: If there is none.
    """
    for frame in get_args(Frame):
        if name == frame:
            return frame
    raise KinfeasError(f"unknown frame {name!r}{no_such(str(name), get_args(Frame))}")


def in_frame(poses: Array, frame: Frame, object_pose: Array) -> Array:
    """Return a path, shape (m, 7), as seen from what it moves with.

    Args:
        poses: In any frame, the world as a rule.
        frame: What the path moves with.
        object_pose: The handled object in the same frame as `poses`, shape (7,).
    """
    origins = {"object": object_pose, "goal": poses[-1], "world": IDENTITY}
    return relative(poses, np.broadcast_to(origins[frame], poses.shape))


def even_moments(duration: float) -> Array:
    """Return the shares of a path of `duration` seconds at which it gets a knot, shape (m + 1,)."""
    segments = min(max(256, math.ceil(duration / _FINEST)), _MOST_SEGMENTS)
    return np.linspace(0.0, 1.0, segments + 1)


def path_through(knots: Array) -> Path:
    """Return the path through knots at even steps of time, shape (m + 1, 7)."""
    return Path(knots, twist_between(knots[:-1], knots[1:], 1.0), None)
