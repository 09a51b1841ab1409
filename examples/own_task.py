"""Define a task of several sub-goals in Python and evaluate it with several robots."""

import argparse
import math

from kinfeas import registry
from kinfeas.evaluation.ceiling import measure_ceiling
from kinfeas.evaluation.evaluate import Trial, evaluate
from kinfeas.evaluation.policies import load_policy
from kinfeas.tasks.chain import BaseStart, ChainLeg, ChainTask, Place
from kinfeas.tasks.task import MotionSpec

WATER_PLANTS = ChainTask(
    name="water_plants",
    start=BaseStart(square=1.0),
    places={
        # Metres and radians; a pair is drawn uniformly for each episode.
        "tap": Place(position=(1.2, (-0.3, 0.3), 0.9)),
        "plant": Place(position=((-0.8, -0.6), 1.2, (0.6, 0.8)), rpy=(0.0, 0.0, math.pi / 2.0)),
    },
    legs=(
        ChainLeg(place="tap", offset=(-0.1, 0.0, 0.0), frame="tip", wait=2.0),
        # A sub-goal above the plant, then slowly down to it.
        ChainLeg(place="plant", offset=(0.0, 0.0, 0.15), frame="tip"),
        ChainLeg(
            place="plant",
            frame="tip",
            motion=MotionSpec("minimum_jerk", {"max_velocity": 0.05}),
        ),
    ),
)


def main() -> None:
    """Evaluate each robot; docs/tasks.md describes the YAML format of tasks."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=2)
    parser.add_argument("--robots", nargs="+", default=["pr2", "hsr"])
    given = parser.parse_args()
    for name in given.robots:
        robot = registry.load_robot(name)
        ceiling = measure_ceiling(robot, WATER_PLANTS, given.episodes, seed=1).share
        trial = Trial(robot, WATER_PLANTS, given.episodes)
        figures = evaluate(trial, load_policy("pretrained", robot), "pretrained", ceiling)
        seconds = figures["mean_steps"] * trial.world.dt
        print(
            f"{name}: success {figures['success']:.2f} of at most {figures['ceiling']:.2f}, "
            f"{seconds:.0f} s an episode"
        )


if __name__ == "__main__":
    main()
