"""Define a task of several sub-goals in code, and evaluate it with several robots."""

import argparse
import math

from kinfeas.evaluation.evaluate import EvalConfig, evaluate
from kinfeas.evaluation.reachability import measure_reachability
from kinfeas.policies.loading import load_policy
from kinfeas.robots.loading import load_robot
from kinfeas.tasks.chain import BaseStart, ChainSubgoal, ChainTask, Place
from kinfeas.tasks.task import MotionSpec

WATER_PLANTS = ChainTask(
    name="water_plants",
    start=BaseStart(square=1.0),
    places={
        # Metres and radians; each episode draws a number between those of a pair.
        "tap": Place(position=(1.2, (-0.3, 0.3), 0.9)),
        "plant": Place(position=((-0.8, -0.6), 1.2, (0.6, 0.8)), rpy=(0.0, 0.0, math.pi / 2.0)),
    },
    subgoals=(
        ChainSubgoal(place="tap", offset=(-0.1, 0.0, 0.0), frame="tip", dwell=2.0),
        # A sub-goal above the plant, then slowly down to it.
        ChainSubgoal(place="plant", offset=(0.0, 0.0, 0.15), frame="tip"),
        ChainSubgoal(
            place="plant",
            frame="tip",
            motion=MotionSpec("minimum_jerk", {"max_velocity": 0.05}),
        ),
    ),
)


def main() -> None:
    """Run some episodes for each robot; docs/tasks.md shows the same as a YAML file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=2)
    parser.add_argument("--robots", nargs="+", default=["pr2", "hsr"])
    options = parser.parse_args()
    for name in options.robots:
        robot = load_robot(name)
        trial = EvalConfig(robot, WATER_PLANTS, options.episodes)
        figures = evaluate(trial, load_policy("pretrained", robot))
        ceiling = measure_reachability(robot, WATER_PLANTS, options.episodes, trial.seed).share
        seconds = figures["mean_steps"] * trial.world.dt
        print(
            f"{name}: success {figures['success']:.2f} of at most {ceiling.value:.2f}, "
            f"{seconds:.0f} s an episode"
        )


if __name__ == "__main__":
    main()
