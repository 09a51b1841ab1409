"""Train TIAGo with transitions of planned episodes in each batch, and print its success.

    python studies/teacher.py --fractions 0 0.25 0.5

The planner drives the base in the world of the recipe, at the full speed of the EE and without its
arm postures, as a policy could. An action is the mean of its commands.
"""

import argparse
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.type_aliases import ReplayBufferSamples
from time_to_level import recipe_of

from kinfeas.config import PluginSpec
from kinfeas.control.filters import path_planner
from kinfeas.control.loop import Outcome
from kinfeas.control.period import Period
from kinfeas.io.policy_metadata import read_trained
from kinfeas.planning.base_path import BasePath
from kinfeas.policies.loading import load_policy
from kinfeas.robots.loading import load_robot
from kinfeas.training import fast_sac
from kinfeas.training.config import TrainConfig
from kinfeas.training.train import train
from kinfeas.training.vec_env import WorldVecEnv
from kinfeas.training.worlds import training_world

EPISODES = 32
"""Planned episodes side by side."""


def planned_transitions(config: TrainConfig, steps: int) -> NDArray[np.float32]:
    """Return rows of a replay buffer from planned episodes."""
    filters = (PluginSpec("path_planner"),)
    world = training_world(
        replace(config, seed=config.seed + 7, world=replace(config.world, filters=filters))
    )
    env = WorldVecEnv(world, EPISODES, config.action_repeat)
    policy = load_policy("follow_ee", load_robot(config.robot))
    commands: list[NDArray[np.float64]] = []
    step = world.loop.step

    def recorded(action: NDArray[np.float64] | None = None) -> Outcome:
        outcome = step(action)
        commands.append(world.loop.previous_command.copy())
        return outcome

    world.loop.step = recorded  # type: ignore[method-assign]
    rows: list[Any] = []
    observation: Any = env.reset()
    for _ in range(steps // (EPISODES * config.action_repeat)):
        commands.clear()
        transition: Any = env.step(policy.act(world.loop.observation))
        following, rewards, dones, infos = transition
        after, truncated = following.copy(), np.zeros(EPISODES)
        for row in np.flatnonzero(dones):
            after[row] = infos[row]["terminal_observation"]
            truncated[row] = infos[row]["TimeLimit.truncated"]
        action = np.mean(commands, axis=0).clip(-0.999, 0.999)
        ends = np.column_stack([rewards, dones, truncated])
        rows.append(np.column_stack([observation, after, action, ends]))
        observation = following
    env.close()
    return np.concatenate(rows).astype(np.float32)


def base_only() -> None:
    """Let paths neither slow down the EE nor guide the posture of the arm."""
    follow = path_planner.PathFollower.__call__

    def unguided(self: Any, period: Period, paths: Mapping[int, BasePath]) -> Period:
        return follow(self, period, paths).changed(posture_guide=period.posture_guide)

    path_planner.PathFollower.__call__ = unguided  # type: ignore[method-assign]
    BasePath.time_scale_at = lambda self, seconds: 1.0  # type: ignore[method-assign]


def mix(rows: NDArray[np.float32], fraction: float) -> None:
    """Take a fraction of each batch from rows of planned episodes."""
    sample, planned = fast_sac.FastReplayBuffer.sample, torch.from_numpy(rows)

    def mixed(self: Any, batch_size: int, env: object = None) -> ReplayBufferSamples:
        count = round(fraction * batch_size)
        drawn = planned[torch.randint(len(planned), (count,))].split(self._widths, dim=1)
        observation, after, action, reward, done, timeout = drawn
        parts = observation, action, after, done * (1.0 - timeout), reward
        own: tuple[Any, ...] = sample(self, batch_size - count)
        return ReplayBufferSamples(*map(torch.cat, zip(own, parts, strict=False)))

    fast_sac.FastReplayBuffer.sample = mixed  # type: ignore[method-assign]


def main() -> None:
    """Plan, train once for each fraction, and print a row for each."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--fractions", type=float, nargs="+", default=[0.0, 0.25, 0.5])
    parser.add_argument("--steps", type=int, default=1_500_000)
    parser.add_argument("--planned-steps", type=int, default=480_000)
    options = parser.parse_args()
    schedule = {"steps": options.steps, "minutes": None, "evaluations": 4, "final_episodes": 500}
    config = recipe_of("tiago", {"schedule": schedule})
    sample = fast_sac.FastReplayBuffer.sample
    base_only()
    rows = planned_transitions(config, options.planned_steps)
    for fraction in options.fractions:
        fast_sac.FastReplayBuffer.sample = sample  # type: ignore[method-assign]
        if fraction:
            mix(rows, fraction)
        with tempfile.TemporaryDirectory() as folder:
            train(config, Path(folder) / "run")
            figures = read_trained(Path(folder) / "run").fresh_evaluation
        print(
            f"{fraction:.0%} planned: success {figures['success']:.1%}, within 5 cm "
            f"{figures['within_5cm']:.1%}, joint jumps {figures['joint_jumps_per_episode']:.2f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
