"""Train a base policy and compare it with two baselines."""

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path

from kinfeas.config.recipes import load_section
from kinfeas.envs.world import evaluation_world
from kinfeas.evaluation.evaluate import EvalConfig, evaluate
from kinfeas.policies.loading import load_policy
from kinfeas.robots.loading import load_robot
from kinfeas.tasks.loading import load_task
from kinfeas.training.config import TrainConfig
from kinfeas.training.train import train


def main() -> None:
    """Train for some steps (200,000 give a useful policy) and evaluate."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=500)
    parser.add_argument("--episodes", type=int, default=4)
    parser.add_argument("--out", type=Path, default=None, help="folder of the run; else temporary")
    options = parser.parse_args()

    config = load_section(TrainConfig, "train", "pr2")
    few = replace(config.learner, learning_starts=min(3000, options.steps // 2))
    schedule = replace(
        config.schedule,
        steps=options.steps,
        minutes=None,
        evaluations=1,
        evaluation_episodes=4,
        final_episodes=4,
    )
    config = replace(config, num_envs=64, learner=few, schedule=schedule)
    with tempfile.TemporaryDirectory() as folder:
        out = options.out or Path(folder) / "run"
        progress = train(config, out)
        print(f"{progress.steps} steps in {progress.seconds:.1f} s")
        print("the run holds", ", ".join(sorted(path.name for path in out.iterdir())))
        robot = load_robot(config.robot)
        alone = replace(evaluation_world(), filters=())
        trial = EvalConfig(robot, load_task(config.task), options.episodes, world=alone)
        for name in (str(out), "follow_ee", "follow_ee_feedback"):
            figures = evaluate(trial, load_policy(name, robot))
            failures = figures["ik_failures_per_episode"]
            print(f"{name}: success {figures['success']:.2f}, {failures:.1f} failures an episode")


if __name__ == "__main__":
    main()
