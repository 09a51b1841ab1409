"""Define a motion generator, register it, and evaluate the pretrained PR2 policy with it."""

import argparse

import numpy as np

from kinfeas.config import registry
from kinfeas.core import spatial
from kinfeas.core.single_motion import batched
from kinfeas.evaluation.evaluate import EvalConfig, evaluate
from kinfeas.policies.loading import load_policy
from kinfeas.robots.loading import load_robot
from kinfeas.tasks.loading import load_task
from kinfeas.testing import check_motion_generator


@batched
class Wave:
    """A line to the target with a sideways oscillation."""

    def __init__(self, *, speed: float = 0.06, sway: float = 0.05) -> None:
        self.speed, self.sway = speed, sway

    def start(self, ee_pose, target_pose, rng):
        """Return the initial state of the motion."""
        return {"time": 0.0}

    def goal_pose(self, state, target_pose):
        """Return the final pose of the motion."""
        return target_pose

    def twist(self, state, ee_pose, target_pose, dt):
        """Return the twist for the next `dt` seconds, and the next state."""
        error = spatial.twist_between(ee_pose, target_pose, 1.0)
        duration = max(
            np.linalg.norm(error[:3]) / self.speed, np.linalg.norm(error[3:]) / 0.1, dt, 1.0
        )
        sideways = np.array([-error[1], error[0], 0.0])
        distance = min(np.linalg.norm(sideways), 1.0)
        sideways *= self.sway * distance / max(np.linalg.norm(sideways), 1e-9)
        twist = error / duration
        twist[:3] += sideways * np.sin(0.5 * state["time"])
        return twist, {**state, "time": state["time"] + dt}


def main() -> None:
    """Check the generator, then evaluate it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=4)
    episodes = parser.parse_args().episodes
    check_motion_generator(Wave(), duration=150.0)
    registry.register("kinfeas.motion_generators", "wave", Wave)
    robot = load_robot("pr2")
    task = load_task("ggr", {"motion": {"generator": "wave"}, "distance": [1.0, 1.5]})
    figures = evaluate(EvalConfig(robot, task, episodes), load_policy("pretrained", robot))
    print(f"{episodes} episodes, success {figures['success']:.2f}")


if __name__ == "__main__":
    main()
