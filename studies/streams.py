"""Evaluate policies on streams of targets and print a table: `python studies/streams.py DIR`.

Each evaluation is a JSON file in DIR, as `kinfeas evaluate --json` writes it; those that exist are
not repeated. `--robots` and `--policies` restrict the evaluations of this process.
"""

import argparse
import json
from collections.abc import Sequence
from itertools import product
from pathlib import Path

from kinfeas.evaluation.evaluate import configure, evaluate
from kinfeas.policies.loading import load_policy
from kinfeas.robots.loading import load_robot
from kinfeas.viz.style import TITLES

ROBOTS, TASKS = ("pr2", "tiago", "hsr"), ("joystick", "chunks", "carried")
ROWS = {
    ("pretrained", "time_scaling"): "policy, time scaling",
    ("pretrained", ""): "policy",
    ("whole_body_qp", "time_scaling"): "`whole_body_qp`, time scaling",
    ("whole_body_qp", ""): "`whole_body_qp`",
    ("stationary", ""): "arm alone",
}
EPISODES = 200


def main() -> None:
    """Run what is missing, then print what there is."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--robots", nargs="*", default=ROBOTS)
    parser.add_argument("--policies", nargs="*", default=[policy for policy, _ in ROWS])
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    for (policy, filters), robot, task in product(ROWS, options.robots, TASKS):
        if policy in options.policies:
            path = options.folder / f"{robot}-{task}-{policy}-{filters or 'none'}.json"
            write_metrics(path, robot, task, policy, filters.split(), EPISODES)
    print(table(options.folder))


def write_metrics(
    path: Path, robot: str, task: str, policy: str, filters: Sequence[str], episodes: int
) -> None:
    """Evaluate a policy into a JSON file, unless it is there."""
    if not path.exists():
        model = load_robot(robot)
        settings = {"world.filters": filters}
        config = configure(model, task, episodes=episodes, settings=settings)
        path.write_text(json.dumps(evaluate(config, load_policy(policy, model), policy), indent=2))


def table(folder: Path) -> str:
    """Return the Markdown table of a folder."""
    head = "| smooth, % / speed, % / RMS deviation, mm | joystick | chunks | carried |"
    lines = [head, "|---|---|---|---|"]
    for robot, ((policy, filters), label) in product(ROBOTS, ROWS.items()):
        cells = []
        for task in TASKS:
            path = folder / f"{robot}-{task}-{policy}-{filters or 'none'}.json"
            cells.append(cell(json.loads(path.read_text())) if path.exists() else "-")
        lines.append(f"| {TITLES[robot]}, {label} | {' | '.join(cells)} |")
    return "\n".join(lines)


def cell(metrics: dict[str, float]) -> str:
    """Return the metrics of an evaluation."""
    fractions = f"{100 * metrics['smooth']:.1f} / {100 * metrics['speed_share']:.0f}"
    return f"{fractions} / {1000 * metrics['rms_deviation_m']:.1f}"


if __name__ == "__main__":
    main()
