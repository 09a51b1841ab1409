"""Simulated seconds per second of CPU time of the physics engines, in the full room.

python studies/physics_speed.py
"""

import time

import numpy as np

from kinfeas.config import registry
from kinfeas.core.spatial import planar_pose
from kinfeas.robots.loading import load_robot
from kinfeas.scenes.scene import read_scene

DT = 0.02
CASES = (("pybullet", 1, 300), ("mujoco", 1, 1500), ("mujoco", 64, 100))


def simulated_seconds(engine: str, robot: str, n: int, periods: int) -> float:
    """Return simulated seconds per second of CPU time; n robots drive and move their arms."""
    world = registry.load("kinfeas.backends", engine)(load_robot(robot), read_scene("room"))
    home = np.repeat(world.robot.home["home"][np.newaxis], n, axis=0)
    world.reset(planar_pose(*np.zeros((3, n))), home)
    twist = np.tile([0.1, 0.05, 0.0, 0.0, 0.0, 0.2], (n, 1))
    for period in range(periods + 5):
        if period == 5:  # kernels are compiled, objects are at rest
            start = time.process_time()
        world.step(twist * np.sin(period / 50), home + 0.05 * np.sin(period / 20), DT)
    seconds = time.process_time() - start
    world.close()
    return n * periods * DT / seconds


if __name__ == "__main__":
    for robot in ("pr2", "tiago", "hsr"):
        figures = [f"{engine} x {n}: {simulated_seconds(engine, robot, n, periods):.0f}"
                   for engine, n, periods in CASES]  # fmt: skip
        print(robot, ", ".join(figures))
