"""Episodes side by side in one world that restart by themselves."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kinfeas.core.spatial import Array
from kinfeas.envs.world import Transition, World


class End(NamedTuple):
    """The end of an episode."""

    observation: Array  # last observation, shape (d,)
    truncated: bool  # whether it ended by the time limit
    success: bool  # whether the goal was reached without a failure
    failures: int  # steps without an IK solution


class BatchStep(NamedTuple):
    """The result of a step of n episodes."""

    observation: Array  # observations, shape (n, d); of the next episode where one has ended
    reward: Array  # mean reward of the control periods of the action, shape (n,)
    ends: dict[int, End]  # ends of episodes by row
    infos: dict[str, NDArray[Any]]  # of `step_info` before restarts, if the batch has `infos`


@dataclass
class Batch:
    """n episodes in one world, which restart by themselves.

    An action is repeated for `action_repeat` control periods and earns their mean reward. If an
    episode ends within them, the mean is over the periods until its end; the next one begins after
    the last period.
    """

    world: World
    size: int
    action_repeat: int = 1
    infos: bool = False

    def start(self) -> Array:
        """Begin fresh episodes everywhere and return their observations, shape (n, d)."""
        return self.world.start_next(self.size)

    def step(self, actions: Array) -> BatchStep:
        """Step all episodes with commands in [-1, 1], shape (n, a)."""
        earned, periods = np.zeros(self.size), np.zeros(self.size)
        over = np.zeros(self.size, dtype=np.bool_)
        ends: dict[int, End] = {}
        for _ in range(self.action_repeat):
            # Rows whose episode is over are stepped along with the others, and ignored.
            transition = self.world.step(actions)
            earned += np.where(over, 0.0, transition.reward)
            periods += ~over
            for row in np.flatnonzero(transition.done & ~over).tolist():
                failures = int(self.world.failures[row])
                success = bool(transition.reached[row]) and failures == 0
                last = transition.observation[row].copy()
                ends[row] = End(last, bool(transition.truncated[row]), success, failures)
            over |= transition.done
            if over.all():
                break
        infos = step_info(self.world, transition) if self.infos else {}
        observation = self.world.loop.observation.values
        if ends:
            rows = np.array(sorted(ends))
            observation = self.world.start_next(rows.size, rows)
        return BatchStep(observation, earned / periods, ends, infos)

    def number(self) -> int:
        """Return the number of the next episode."""
        return self.world.next_episode

    def snapshot(self) -> dict[str, NDArray[Any]]:
        """Return the state to resume from, by name."""
        world = self.world.snapshot() if self.world.loop.resumable else {}
        return {**world, "next_episode": np.array(self.number())}

    def restore(self, snapshot: Mapping[str, NDArray[Any]]) -> Array:
        """Resume from a snapshot and return the observations, shape (n, d).

        Without a state of the world the next episodes begin.
        """
        self.world.next_episode = int(snapshot["next_episode"])
        if self.world.loop.resumable and snapshot.keys() > {"next_episode"}:
            return self.world.restore(snapshot)
        return self.start()


def step_info(world: World, transition: Transition) -> dict[str, NDArray[Any]]:
    """Return the infos of a step of n episodes by name, each of shape (n,).

    `failures` counts from the beginning of the episode; `is_success` is a goal reached without a
    failure. Backends that measure contacts add the numbers of contacts of base and arm.
    """
    outcome, failures = transition.outcome, world.failures.copy()
    info: dict[str, NDArray[Any]] = {
        "subgoal": outcome.subgoal, "feasible": outcome.feasible, "failures": failures,
        "deviation": outcome.deviation, "goal_distance": outcome.goal_distance,
        "goal_angle": outcome.goal_angle, "joint_jump": outcome.joint_jump,
        "reached": transition.reached, "is_success": transition.reached & (failures == 0),
    }  # fmt: skip
    if (sensor := world.backend.contacts) is not None:
        contacts = [sensor.touching(row) for row in range(len(failures))]
        info["base_contacts"] = np.array([len(contact.base) for contact in contacts])
        info["arm_contacts"] = np.array([len(contact.arm) for contact in contacts])
    return info
