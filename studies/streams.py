"""Evaluate policies on streams of targets and print a table: `python studies/streams.py DIR`.

Each evaluation is a JSON file in DIR, as `kinfeas evaluate --json` writes it; those that exist are
not repeated. `--robots` and `--policies` restrict the evaluations of this process.
"""

import argparse
import json
from itertools import product
from pathlib import Path

from kinfeas.evaluation.evaluate import configure, evaluate
from kinfeas.policies.loading import load_policy
from kinfeas.robots.loading import load_robot

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
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    for (policy, filters), robot, task in product(ROWS, given.robots, TASKS):
        path = given.folder / f"{robot}-{task}-{policy}-{filters or 'none'}.json"
        if policy in given.policies and not path.exists():
            chosen = {"world.filters": [filters] if filters else []}
            known = load_robot(robot)
            config = configure(known, task, episodes=EPISODES, settings=chosen)
            path.write_text(
                json.dumps(evaluate(config, load_policy(policy, known), policy), indent=2)
            )
    print(table(given.folder))


def table(folder: Path) -> str:
    """Return the Markdown table of a folder."""
    head = "| smooth, % / speed, % / RMS deviation, mm | joystick | chunks | carried |"
    lines = [head, "|---|---|---|---|"]
    for robot, ((policy, filters), label) in product(ROBOTS, ROWS.items()):
        cells = []
        for task in TASKS:
            path = folder / f"{robot}-{task}-{policy}-{filters or 'none'}.json"
            cells.append(cell(json.loads(path.read_text())) if path.exists() else "-")
        name = {"pr2": "PR2", "tiago": "TIAGo", "hsr": "HSR"}[robot]
        lines.append(f"| {name}, {label} | {' | '.join(cells)} |")
    return "\n".join(lines)


def cell(found: dict[str, float]) -> str:
    """Return the metrics of an evaluation."""
    shares = f"{100 * found['smooth']:.1f} / {100 * found['speed_share']:.0f}"
    return f"{shares} / {1000 * found['rms_deviation_m']:.1f}"


if __name__ == "__main__":
    main()
