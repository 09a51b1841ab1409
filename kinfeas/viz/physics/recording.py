"""An episode in the PyBullet world, kept to be looked at: all bodies, and what was desired."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from kinfeas.backends.pybullet.camera import Moment, keep_moment
from kinfeas.control.loop import Rows
from kinfeas.core.policy import Policy
from kinfeas.core.spatial import Array
from kinfeas.envs.world import Transition, World
from kinfeas.evaluation.physics.world import PhysicsTrial, PhysicsWorld
from kinfeas.io.run_log import TASK_DONE

_RATE = 25.0  # moments kept per second, at most


@dataclass(frozen=True, eq=False)
class PhysicsRecording:
    """One episode at t moments, evenly in time.

    Attributes:
        episode: Its number.
        times: Seconds since its beginning, shape (t,).
        moments: Where all bodies were.
        base: World position of the base, shape (t, 3).
        ee: Achieved world position of the EE, shape (t, 3); the true one, whatever sensors say.
        desired: Desired world position of the EE, shape (t, 3).
        goal: World position of the end of the sub-goal under way, shape (t, 3).
        failures: Kinematic failures since the moment before, shape (t,).
        reached: Whether the goal was reached.
        done: Whether the task was done; None if it wants nothing of objects, or there are none.
    """

    episode: int
    times: Array
    moments: tuple[Moment, ...]
    base: Array
    ee: Array
    desired: Array
    goal: Array
    failures: NDArray[np.intp]
    reached: bool
    done: bool | None

    @property
    def outcome(self) -> str:
        """What the episode came to, in words."""
        goal = "goal reached" if self.reached else "goal not reached"
        return goal + TASK_DONE[self.done]

    @property
    def succeeded(self) -> bool:
        """Whether the goal was reached, and the task done if there was one to do."""
        return self.reached and self.done is not False

    @property
    def goals(self) -> Array:
        """Where the sub-goals end, each once, in order, shape (sub-goals, 3)."""
        changes = np.any(np.diff(self.goal, axis=0) != 0.0, axis=1)
        return self.goal[np.concatenate([[True], changes])]


def record(
    world: PhysicsWorld, trial: PhysicsTrial, policy: Policy, episode: int
) -> PhysicsRecording:
    """Return one episode of a trial, which happens once more for that.

    Args:
        world: Of the trial; it is left at the end of the episode.
        trial: What the episode belongs to.
        policy: Moves the base.
        episode: Its number.
    """
    kept = _Kept(world, max(1, round(1.0 / (_RATE * trial.settings.dt))))
    records = world.run(policy, range(episode, episode + 1), watch=kept)
    base, ee, desired, goal = (np.array(rows) for rows in zip(*kept.places, strict=True))
    return PhysicsRecording(
        episode,
        np.array(kept.times),
        tuple(kept.moments),
        base,
        ee,
        desired,
        goal,
        np.array(kept.failures),
        bool(records.reached[0]),
        None if world.stage.done() is None else bool(records.done[0]),
    )


@dataclass
class _Kept:
    """What has been seen so far."""

    world: PhysicsWorld
    every: int
    steps: int = 0
    failed: int = 0
    times: list[float] = field(default_factory=list)
    moments: list[Moment] = field(default_factory=list)
    places: list[tuple[Array, ...]] = field(default_factory=list)
    failures: list[int] = field(default_factory=list)

    def __call__(self, world: World, transition: Transition, rows: Rows, episodes: Rows) -> None:
        self.failed += int(not transition.step.feasible[0])
        if self.steps % self.every == 0 or transition.done[0]:
            loop = world.loop
            self.times.append((self.steps + 1) * loop.dt)
            self.moments.append(keep_moment(self.world.stage.backend.sims[0].physics))
            seen = (*loop.true_state, loop.desired, loop.goal)
            self.places.append(tuple(pose[0, :3].copy() for pose in seen))
            self.failures.append(self.failed)
            self.failed = 0
        self.steps += 1
