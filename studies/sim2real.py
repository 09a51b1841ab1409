"""Shipped policies behind the adapters of a robot, with and without prediction of its response.

`python studies/sim2real.py` writes docs/figures/sim2real.json and prints the table of
docs/reference/measurements.md. It takes hours on two cores; it continues where it was interrupted.
"""

import argparse
import json
from pathlib import Path
from typing import Any

import kinfeas

FIGURES = Path(__file__).parents[1] / "docs" / "figures" / "sim2real.json"
ROBOTS, LISTS = ("pr2", "tiago", "hsr"), ("ideal", "pr2_like", "harsh")
COLUMNS = "success", "tracked_5cm", "within_5cm", "mean_tracking_error_m", "mean_deviation_m"
AT_ONCE: dict[str, object] = {"world.response": {}, "world.filters": []}
"""Settings of a loop that assumes that commands take effect at once, as before version 0.3."""


def cells() -> list[tuple[str, str, str, str, bool]]:
    """Return world, task, robot, list of adapters, and whether the loop predicts."""
    analytic = [
        ("analytic", "ggr", robot, adapters, predicts)
        for robot in ROBOTS
        for adapters in LISTS
        for predicts in (True, False)
        if predicts or adapters != "ideal"
    ]
    physics = [
        ("pybullet", task, robot, adapters, True)
        for task in ("ggr", "door")
        for robot in ROBOTS
        for adapters in LISTS[1:]
    ]
    return analytic + physics


def measure(world: str, task: str, robot: str, adapters: str, predicts: bool, episodes: int) -> Any:
    """Return the metrics of a cell; the ideal world runs at the rate of the others."""
    settings = {} if predicts else AT_ONCE
    if adapters == "ideal":
        settings = {"world.dt": 0.02, "world.max_failures": 99}
    return kinfeas.evaluate(
        "pretrained", robot=robot, task=task, world=world, adapters=adapters, episodes=episodes,
        settings=settings,
    )  # fmt: skip


def table(figures: dict[str, Any]) -> str:
    """Return the figures as Markdown."""
    head = ["world", "task", "robot", "adapters", "prediction", "success, %"]
    head += ["tracked within 5 cm, %", "truly within 5 cm, %"]
    head += ["tracking error, mm", "EE deviation, mm", "task success, %"]
    lines = [head, ["---"] * len(head)]
    for key, row in figures.items():
        world, task, robot, adapters, predicts = key.split()
        fractions = [f"{100 * row[name]:.1f}" for name in COLUMNS[:3]]
        errors = [f"{1000 * row[name]:.1f}" for name in COLUMNS[3:]]
        done = "-" if task == "ggr" else f"{100 * row['task_success']:.1f}"
        predicts = "-" if adapters == "ideal" else predicts
        lines.append([world, task, robot, adapters, predicts, *fractions, *errors, done])
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def main() -> None:
    """Measure the cells that are missing and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=200)
    parser.add_argument("--physics-episodes", type=int, default=100)
    parser.add_argument("--world", choices=["analytic", "pybullet"])
    options = parser.parse_args()
    for world, task, robot, adapters, predicts in cells():
        key = f"{world} {task} {robot} {adapters} {'yes' if predicts else 'no'}"
        figures = json.loads(FIGURES.read_text()) if FIGURES.exists() else {}
        if key in figures or options.world not in (None, world):
            continue
        episodes = options.episodes if world == "analytic" else options.physics_episodes
        metrics = measure(world, task, robot, adapters, predicts, episodes)
        figures = json.loads(FIGURES.read_text()) if FIGURES.exists() else {}
        kept = (*COLUMNS, "episodes", "task_success", "joint_jumps_per_episode", "lateness_s")
        figures[key] = {name: metrics[name] for name in kept}
        FIGURES.write_text(json.dumps(figures, indent=1) + "\n")
    figures = json.loads(FIGURES.read_text())
    order = [" ".join((*cell[:4], "yes" if cell[4] else "no")) for cell in cells()]
    print(table({key: figures[key] for key in order if key in figures}))


if __name__ == "__main__":
    main()
