"""Trials of motion generators, and the motions of a trial."""

import traceback
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from kinfeas.core.checks import CheckedMotion
from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import Array, integrate, make_pose


@dataclass(frozen=True)
class Trial:
    """Motions and limits of a test.

    Attributes:
        seed: Seed of the random poses and of the generator's random numbers.
        duration: Time limit of each motion in seconds.
        dt: Duration of a step in seconds.
        max_velocity: Maximum speed, m/s; None for no limit.
        max_angular_velocity: Maximum angular speed, rad/s; None for no limit.
    """

    seed: int = 0
    duration: float = 120.0
    dt: float = 0.1
    max_velocity: float | None = 0.1
    max_angular_velocity: float | None = 0.1

    @property
    def steps(self) -> int:
        """Count of steps."""
        return max(1, round(self.duration / self.dt))

    def poses(self) -> tuple[Array, Array]:
        """Return starts and targets of the motions, each of shape (12, 7).

        Eight motions to random targets from a random pose up to 2 m away, and four special ones:
        from the target itself, half a turn on the spot, a path without rotation, a rotation almost
        on the spot.
        """
        rng = np.random.default_rng(self.seed)
        targets = _random_poses(rng, 8)
        starts = _random_poses(rng, len(targets))
        starts[:, :3] = targets[:, :3] + rng.uniform(-1.15, 1.15, (len(targets), 3))
        ends = np.resize(targets, (4, 7))
        position, orientation = ends[:, :3], Rotation.from_quat(ends[:, 3:])
        away = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.8, 0.0, 0.6], [1e-7, 0.0, 0.0]])
        turn = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, np.pi], [0.0, 0.0, 0.0], [0.0, 2.5, 0.0]])
        special = make_pose(position + away, Rotation.from_rotvec(turn) * orientation)
        return np.concatenate([starts, special]), np.concatenate([targets, ends])


@dataclass(frozen=True, eq=False)
class Samples:
    """t steps of n motions: world poses (t + 1, n, 7), twists (t, n, 6) and goals (n, 7)."""

    ee_pose: Array
    twist: Array
    goal: Array


def sample_motions(motion: CheckedMotion, trial: Trial) -> Samples:
    """Return the motions of a trial."""
    ee_pose, targets = trial.poses()
    rngs = [np.random.default_rng([trial.seed, row]) for row in range(len(targets))]
    state = motion.start(ee_pose.copy(), targets.copy(), rngs)
    goal, poses, twists = motion.goal_pose(state, targets), [ee_pose], []
    for _ in range(trial.steps):
        twist, state = motion.twist(state, ee_pose, targets, np.full(len(targets), trial.dt))
        ee_pose = integrate(ee_pose, twist, trial.dt)
        poses.append(ee_pose)
        twists.append(twist)
    return Samples(np.stack(poses), np.stack(twists), goal)


def describe(error: BaseException, subject: str) -> str:
    """Return the message of an error; that of a plugin's own exception has subject and place."""
    if isinstance(error, KinfeasError):
        return str(error)
    frame = traceback.extract_tb(error.__traceback__)[-1]
    location = f"{Path(frame.filename).name}, line {frame.lineno}"
    return f"{subject} raises {type(error).__name__}: {error} ({location})"


def _random_poses(rng: np.random.Generator, n: int) -> Array:
    """Return poses in a room of 4 x 4 m with any orientation, shape (n, 7)."""
    position = rng.uniform([-2.0, -2.0, 0.3], [2.0, 2.0, 1.2], (n, 3))
    return make_pose(position, Rotation.from_quat(rng.normal(size=(n, 4))))
