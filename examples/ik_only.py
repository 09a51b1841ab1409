"""Use the batched inverse kinematics: solve, check and compute reachability."""

import argparse
import time

import numpy as np

from kinfeas.core import spatial
from kinfeas.evaluation.reachability import measure_reachability
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolver, spread_configurations
from kinfeas.robots.loading import load_robot
from kinfeas.tasks.loading import load_task


def main() -> None:
    """Solve random poses, then measure the reachability of random goals."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robot", default="hsr", help="a name, or the path of a robot's YAML")
    parser.add_argument("--poses", type=int, default=1000)
    parser.add_argument("--goals", type=int, default=20)
    options = parser.parse_args()

    robot = load_robot(options.robot)
    solver = IkSolver(robot)
    joints = spread_configurations(robot, options.poses)
    joints = joints[solver.admissible(joints)]
    poses, seeds = forward(solver.chain, joints), joints[::-1].copy()
    solver.solve(poses[:1], seeds[:1])  # compiles the kernels or loads them from the cache
    began = time.perf_counter()
    solution = solver.solve(poses, seeds)
    seconds = time.perf_counter() - began
    print(f"{robot.name}: {np.mean(solution.feasible):.3f} of {len(poses)} poses have a solution")
    print(f"{1e6 * seconds / len(poses):.1f} us a pose, from arbitrary seeds")

    feasible = solution.feasible
    reached = forward(solver.chain, solution.joint_positions[feasible])
    metres, radians = spatial.distance(reached, poses[feasible])
    print(f"maximum error {1000 * metres.max():.3f} mm and {np.rad2deg(radians.max()):.3f} degrees")

    ceiling = measure_reachability(robot, load_task("ggr"), options.goals, seed=1)
    fraction = ceiling.share.value
    print(f"{fraction:.2f} of {options.goals} random goals are reachable from some base pose")


if __name__ == "__main__":
    main()
