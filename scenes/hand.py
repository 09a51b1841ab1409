"""The simulated hand: how a person's hand reaches for a handle and pulls it."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from kinfeas.config.quantities import NotNegative, Positive, Share
from kinfeas.core.spatial import Array, compose, make_pose, relative, rotation
from kinfeas.scenes.mechanism import Mechanism

# The fingers hold the handle in the plane; up and down they slide on it.
_HELD = np.array([1.0, 1.0, 0.0])
_STEPS = 10  # of the simulation in each sample
_DRIFT_PERIODS = (1.3, 2.9)  # s, shortest and longest


@dataclass(frozen=True)
class Habits:
    """How the hand moves: `hand.yaml` says what each number means."""

    sample_rate: Positive
    duration: tuple[Positive, Positive]
    drift: NotNegative
    grasp_scatter: NotNegative
    grasp_turn_scatter: NotNegative
    start_scatter: NotNegative
    start_turn_scatter: NotNegative
    joint_misjudged: NotNegative
    opening_scatter: NotNegative
    slip: Share
    slip_scatter: NotNegative
    arm_length: Positive
    stand_scatter: NotNegative
    base_share: Share
    mass: Positive
    arm_stiffness: Positive
    grip_stiffness: Positive


def minimum_jerk(share: Array) -> Array:
    """Return the share of the way that is made after a `share` of the time (Flash, Hogan 1985)."""
    return share**3 * (10.0 + share * (6.0 * share - 15.0))


def scatter(rng: np.random.Generator, spread: float, mask: Array) -> Array:
    """Return a random vector, shape (3,), that is zero where `mask` is.

    Its length has the root mean square `spread`, but for the few that are cut at twice that.
    """
    drawn = rng.normal(size=3) * mask * spread / np.sqrt(np.sum(mask))
    length = np.sqrt(np.sum(drawn**2))
    return drawn if length <= 2.0 * spread else drawn * (2.0 * spread / length)


def drift(rng: np.random.Generator, time: Array, size: float) -> Array:
    """Return a slow wandering of root mean square `size`, zero at first; (t,) -> (t, 3), m."""
    period, phase = rng.uniform(*_DRIFT_PERIODS, (2, 3)), rng.uniform(0.0, 2.0 * np.pi, (2, 3))
    waves = np.sin(2.0 * np.pi * time[:, np.newaxis, np.newaxis] / period + phase)
    wandering = np.sum(waves, axis=1)
    # Two waves an axis and the shift to zero: a mean square of 2 on each of three axes.
    return size / np.sqrt(6.0) * (wandering - wandering[0])


def samples(habits: Habits, rng: np.random.Generator) -> Array:
    """Return the moments at which a motion of random duration is recorded, shape (t,), s."""
    return np.arange(round(rng.uniform(*habits.duration) * habits.sample_rate) + 1) / (
        habits.sample_rate
    )


def reach(start: Array, end: Array, time: Array, wander: Array) -> Array:
    """Return a straight reach with minimum jerk.

    Args:
        start: First pose, shape (7,).
        end: Last pose but for the wandering, shape (7,).
        time: Moments, shape (t,).
        wander: What the hand adds to its way, shape (t, 3).

    Returns:
        Poses of the hand, shape (t, 7).
    """
    share = minimum_jerk(time / time[-1])[:, np.newaxis]
    turn = (rotation(end) * rotation(start).inv()).as_rotvec()
    turned = Rotation.from_rotvec(share * turn) * rotation(start)
    return make_pose(start[:3] + share * (end[:3] - start[:3]) + wander, turned)


def pull(
    mechanism: Mechanism, hand: Array, wanted: Array, habits: Habits, slip: float
) -> tuple[Array, Array]:
    """Pull a handle along and return where the hand went.

    The hand is a mass between two springs with dampers: one draws it to where it wants to be, the
    other is its grip on the handle, which goes where the joint lets it.

    Args:
        mechanism: What is pulled; it is left where the pull ended.
        hand: Pose in which the hand holds the handle, shape (7,).
        wanted: Where the hand wants to be at each step, `fine_times` apart, shape (m, 3).
        habits: Masses, springs and rates.
        slip: Share of the handle's turn that the hand does not make.

    Returns:
        Poses of the hand and of the handle at each sample, shape (t, 7).
    """
    dt = 1.0 / (habits.sample_rate * _STEPS)
    arm, grip = (_Spring(k, habits.mass, dt) for k in (habits.arm_stiffness, habits.grip_stiffness))
    held = relative(hand, mechanism.handle_pose())
    position, velocity = hand[:3].copy(), np.zeros(3)
    way, handles = [position], [mechanism.handle_pose()]
    for aim in wanted[1:]:
        point = compose(handles[-1], held)[:3]
        by_handle = grip.force(point - position) * _HELD
        velocity = velocity + dt / habits.mass * (by_handle + arm.force(aim - position))
        position = position + dt * velocity
        mechanism.pull(-by_handle, point, dt)
        way.append(position)
        handles.append(mechanism.handle_pose())
    return _recorded(hand, np.array(way)[::_STEPS], np.array(handles)[::_STEPS], slip)


def fine_times(time: Array) -> Array:
    """Return the moments of the simulation's steps between and at the samples `time`."""
    return np.linspace(time[0], time[-1], (len(time) - 1) * _STEPS + 1)


class _Spring:
    """A critically damped spring of `mass`, which feels how its length changes."""

    def __init__(self, stiffness: float, mass: float, dt: float) -> None:
        self._stiffness, self._damping = stiffness, 2.0 * np.sqrt(stiffness * mass)
        self._dt, self._before = dt, np.zeros(3)

    def force(self, stretch: Array) -> Array:
        rate, self._before = (stretch - self._before) / self._dt, stretch
        return self._stiffness * stretch + self._damping * rate


def _recorded(hand: Array, way: Array, handles: Array, slip: float) -> tuple[Array, Array]:
    turn = (rotation(handles) * rotation(handles[0]).inv()).as_rotvec()
    turned = Rotation.from_rotvec((1.0 - slip) * turn) * rotation(hand)
    return make_pose(way, turned), handles
