"""Compare base poses of `kinfeas reach` with random ones near the object, as simulators draw them.

    python studies/placement.py --episodes 60

Simulated kitchens place robots by drawing base points within 0.7 m of the object, facing it, up to
ten times, until the base is free; here IK also has to reach the EE pose. EE poses are those at the
ends of all sub-goals of tasks with furniture, of which base and arm must be free. Writes
docs/figures/placement.json.
"""

import argparse
import time
from collections.abc import Callable
from itertools import product
from pathlib import Path

import numpy as np

from kinfeas.control.subgoal_motions import subgoal_ends
from kinfeas.core.files import write_json
from kinfeas.core.metrics import wilson
from kinfeas.core.solids import Solids
from kinfeas.core.spatial import Array, planar_pose, relative
from kinfeas.core.start import stacked
from kinfeas.kinematics.ik import IkSolver
from kinfeas.kinematics.solids import base_collides, in_base
from kinfeas.planning.reach import BasePlacer
from kinfeas.robots.loading import load_robot
from kinfeas.tasks.chain import ChainTask
from kinfeas.tasks.loading import load_task
from kinfeas.tasks.task import build_subgoals

ROBOTS, TASKS = ("pr2", "tiago", "hsr"), ("pick_place", "door", "drawer", "shelf")
Goal = tuple[Array, Solids]
RADIUS, TRIES = 0.7, 10  # m, and base poses, of the random placement


def draw_goals(task: ChainTask, solver: IkSolver, rng: np.random.Generator) -> list[Goal]:
    """Return the EE poses at the ends of the sub-goals of an episode, with the furniture."""
    start = stacked([task.sample(solver, rng)])
    ends = subgoal_ends(solver, build_subgoals(task.subgoals), start, [rng])[0]
    solids = task.furniture(start.target_poses[0])
    return [] if solids is None else [(end, solids) for end in ends]


def place_randomly(
    placer: BasePlacer, goal: Array, solids: Solids, rng: np.random.Generator
) -> bool:
    """Return whether one of ten random base poses near the goal is free and reaches it."""
    home = placer.solver.robot.home["home"][np.newaxis]
    for _ in range(TRIES):
        away, bearing = RADIUS * np.sqrt(rng.random()), rng.uniform(-np.pi, np.pi)
        x, y = goal[0] - away * np.cos(bearing), goal[1] - away * np.sin(bearing)
        base = planar_pose(*np.array([[x], [y], [bearing]]))
        if base_collides(placer.solver.collision, base, solids)[0]:
            continue
        target = relative(goal[np.newaxis], base)
        if placer.solver.solve(target, home, solids=in_base(solids, base)).feasible[0]:
            return True
    return False


def measure(place: Callable[[Array, Solids], bool], goals: list[Goal]) -> dict[str, float]:
    """Return the fraction of goals with a base pose, its 95 % interval, and CPU milliseconds."""
    reached, seconds = [], []
    for goal, solids in goals:
        begin = time.process_time()
        reached.append(place(goal, solids))
        seconds.append(time.process_time() - begin)
    fraction = wilson(sum(reached), len(reached))
    return {
        "success": fraction.value, "low": fraction.low, "high": fraction.high,
        "median_ms": round(1e3 * float(np.median(seconds)), 2),
        "mean_ms": round(1e3 * float(np.mean(seconds)), 2),
    }  # fmt: skip


def compare(robot: str, task: str, episodes: int) -> dict[str, dict[str, float]]:
    """Return the figures of both placements at the goals of a task."""
    placer, rng = BasePlacer(load_robot(robot)), np.random.default_rng(4)
    chain = load_task(task)
    if not isinstance(chain, ChainTask):
        raise TypeError(f"{task} has no furniture")
    goals = [goal for _ in range(episodes) for goal in draw_goals(chain, placer.solver, rng)]
    placer.place(*goals[0])  # compiles
    return {
        "random": measure(lambda goal, solids: place_randomly(placer, goal, solids, rng), goals),
        "reach": measure(lambda goal, solids: placer.place(goal, solids).reachable, goals),
    }


def main() -> None:
    """Measure all robots and scenes, print a table and write the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=60)
    parser.add_argument("--out", type=Path, default=Path("docs/figures/placement.json"))
    options = parser.parse_args()
    figures: dict[str, dict[str, dict[str, dict[str, float]]]] = {}
    print("| robot, task | random: success, mean time | reach: success, mean time |\n|---|---|---|")
    for robot, task in product(ROBOTS, TASKS):
        row = compare(robot, task, options.episodes)
        figures.setdefault(robot, {})[task] = row
        cells = (f"{100 * v['success']:.1f} %, {v['mean_ms']:.1f} ms" for v in row.values())
        print(f"| {robot}, {task} | {' | '.join(cells)} |", flush=True)
    write_json(figures, options.out)


if __name__ == "__main__":
    main()
