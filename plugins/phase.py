"""KinematicStep a path by its phase: the hand comes to it first, then goes along."""

from dataclasses import dataclass

import numpy as np

from kinfeas.core.spatial import Array, compose, twist_between
from kinfeas.plugins.limits import norm, positive, slowed
from kinfeas.plugins.path import Path


@dataclass(frozen=True, kw_only=True)
class PhaseControl:
    """Phase dynamic system on R^3 x S^3: where the hand goes next, and how far along it is.

    The hand is drawn to the point of the path that the phase s in [0, 1] stands for, and the phase
    goes on only as the hand is near that point: `s' = psi / T` with `psi = exp(-|e_p|^2 / a^2 -
    |e_r|^2 / b^2)` of the errors in position and orientation. The twist is what the phase demands
    less `gain` times the errors. Where it would exceed a limit, hand and phase slow down together.
    So the hand first comes to the beginning of the path, then moves along it, from any start, and
    ends at its end exactly.

    Attributes:
        path: What is followed, in a frame that may lie anywhere.
        duration: The time T in seconds that the path takes a hand that is on it.
        gain: Rate at which errors decay, 1/s.
        position_scale: The length a: the error at which the phase slows down by e, in metres.
        rotation_scale: The same angle b in radians.
        max_velocity: Upper limit of the speed in m/s.
        max_angular_velocity: Upper limit of the angular speed in rad/s.
    """

    path: Path
    duration: float
    gain: float = 1.0
    position_scale: float = 0.05
    rotation_scale: float = 0.3
    max_velocity: float = 0.1
    max_angular_velocity: float = 0.1

    def __post_init__(self) -> None:
        """Raise KinfeasError if a number is not positive."""
        limits = "max_velocity", "max_angular_velocity"
        for name in ("gain", "position_scale", "rotation_scale", *limits):
            positive(name, getattr(self, name))

    def step(self, frame: Array, phase: Array, ee_pose: Array, dt: Array) -> tuple[Array, Array]:
        """Return the world twist for the next `dt` seconds, shape (n, 6), and the next phase, (n,).

        Args:
            frame: World pose of the frame that the path is in, shape (n, 7).
            phase: Share of the path that is behind the hand, shape (n,).
            ee_pose: World pose that the motion has come to, shape (n, 7).
            dt: Duration of each motion's step in seconds, shape (n,).
        """
        here = compose(frame, self.path.at(phase))
        error = twist_between(here, ee_pose, 1.0)
        advance = np.minimum(self._nearness(error) * dt / self.duration, 1.0 - phase)
        there = compose(frame, self.path.at(phase + advance))
        # A step longer than 1 / gain would shoot past the path.
        gain = np.minimum(self.gain, 1.0 / dt)[:, np.newaxis]
        wanted = twist_between(here, there, dt) - gain * error
        share = slowed(wanted, self.max_velocity, self.max_angular_velocity)
        return wanted * share[:, np.newaxis], phase + share * advance

    def _nearness(self, error: Array) -> Array:
        """Return psi in [0, 1], shape (n, 6) -> (n,): how near the hand is to its path."""
        metres, radians = norm(error[:, :3]), norm(error[:, 3:])
        nearness: Array = np.exp(
            -((metres / self.position_scale) ** 2) - (radians / self.rotation_scale) ** 2
        )
        return nearness
