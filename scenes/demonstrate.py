"""Demonstrations of the simulated hand: it grasps the handle of a door or a drawer and opens it."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from kinfeas import config
from kinfeas.core.spatial import Array, compose, make_pose, planar_pose, rotation
from kinfeas.io.demonstrations import Demonstration
from kinfeas.scenes.exercise import Exercise
from kinfeas.scenes.hand import (
    Habits,
    drift,
    fine_times,
    minimum_jerk,
    pull,
    reach,
    samples,
    scatter,
)
from kinfeas.scenes.mechanism import AnalyticMechanism

_EVERY_AXIS = np.ones(3)
_NO_FINGER_AXIS = np.array([1.0, 0.0, 1.0])
_ROOM = 2.0  # m, half the side of the square in which the furniture's room is put down
_DIGITS = 6  # of what is recorded: micrometres


@dataclass(frozen=True)
class Take:
    """One try: the reach for the handle, and the pull that follows."""

    grasp: Demonstration
    open: Demonstration


def load_habits() -> Habits:
    """Return the habits of the simulated hand."""
    return config.load(Habits, Path(__file__).parent / "hand.yaml")


def demonstrate(exercise: Exercise, habits: Habits, count: int, seed: int) -> list[Take]:
    """Return `count` takes; the first ones of a seed do not depend on how many there are."""
    return [
        _take(exercise, habits, np.random.default_rng((seed, number))) for number in range(count)
    ]


def _take(exercise: Exercise, habits: Habits, rng: np.random.Generator) -> Take:
    x, y, yaw = rng.uniform(-1.0, 1.0, 3) * [_ROOM, _ROOM, np.pi]
    room = planar_pose(x, y, yaw)
    handle = exercise.handle
    reach_time, reached = _reach(exercise, habits, rng)
    pull_time, pulled = _pull(exercise, habits, reached[-1], rng)
    stand = _stand(handle, habits, rng)
    bases = (
        _base(reached, reach_time, stand, habits, arriving=True),
        _base(pulled, pull_time, stand, habits, arriving=False),
    )
    recorded = [
        _record(room, time, hand, base, handle)
        for time, hand, base in zip((reach_time, pull_time), (reached, pulled), bases, strict=True)
    ]
    return Take(*recorded)


def _reach(exercise: Exercise, habits: Habits, rng: np.random.Generator) -> tuple[Array, Array]:
    time = samples(habits, rng)
    # The fingers centre the handle between them when they close.
    grasp = _near(
        np.zeros(3),
        exercise.plan.gripper_roll,
        scatter(rng, habits.grasp_scatter, _NO_FINGER_AXIS),
        scatter(rng, habits.grasp_turn_scatter, _EVERY_AXIS),
    )
    start = _near(
        np.array(exercise.plan.start),
        exercise.plan.gripper_roll,
        scatter(rng, habits.start_scatter, _EVERY_AXIS),
        scatter(rng, habits.start_turn_scatter, _EVERY_AXIS),
    )
    path = reach(start, grasp, time, drift(rng, time, habits.drift))
    return time, compose(exercise.handle, path)


def _near(position: Array, roll: float, shift: Array, turn: Array) -> Array:
    """Return a pose of the rolled gripper in the handle's frame, shifted and turned in its own."""
    rolled = Rotation.from_rotvec([roll, 0.0, 0.0])
    return make_pose(position + rolled.apply(shift), rolled * Rotation.from_rotvec(turn))


def _pull(
    exercise: Exercise, habits: Habits, hand: Array, rng: np.random.Generator
) -> tuple[Array, Array]:
    time = samples(habits, rng)
    fine = fine_times(time)
    misjudged = scatter(rng, habits.joint_misjudged, _EVERY_AXIS)
    believed = replace(exercise.joint, origin=tuple(exercise.joint.origin + misjudged))
    opening = exercise.plan.opening * (1.0 + habits.opening_scatter * rng.normal())
    slip = habits.slip + habits.slip_scatter * rng.normal()
    share = minimum_jerk(fine / fine[-1])
    wanted = believed.carry(hand, opening * share)[:, :3] + drift(rng, fine, habits.drift)
    wanted[:, 2] += exercise.plan.rise * share
    mechanism = AnalyticMechanism(exercise.joint, exercise.handle)
    path, _ = pull(mechanism, hand, wanted, habits, slip)
    return time, path


def _stand(handle: Array, habits: Habits, rng: np.random.Generator) -> Array:
    """Return where the base stands when the hand is at the handle, shape (2,), metres."""
    behind = np.array([-habits.arm_length, 0.0, 0.0])
    place = behind + scatter(rng, habits.stand_scatter, np.array([1.0, 1.0, 0.0]))
    return (handle[:3] + rotation(handle).apply(place))[:2]


def _base(hand: Array, time: Array, stand: Array, habits: Habits, *, arriving: bool) -> Array:
    """Return the base poses beside a hand path: straight along with it, facing the hand."""
    share = minimum_jerk(time / time[-1])[:, np.newaxis] - (1.0 if arriving else 0.0)
    place = stand + habits.base_share * share * (hand[-1, :2] - hand[0, :2])
    toward = hand[:, :2] - place
    return planar_pose(place[:, 0], place[:, 1], np.arctan2(toward[:, 1], toward[:, 0]))


def _record(room: Array, time: Array, hand: Array, base: Array, handle: Array) -> Demonstration:
    poses = (compose(room, pose) for pose in (hand, base, np.broadcast_to(handle, hand.shape)))
    return Demonstration(time, *(np.round(pose, _DIGITS) for pose in poses))
