"""Evaluate policies among solids and on empty floors, and print a table.

`python studies/rooms.py DIR`: each evaluation is a JSON file in DIR, as `kinfeas evaluate --json`
writes it; those that exist are not repeated. `--tasks`, `--policies` and `--filters` (numbers
of rows in `FILTERS`) restrict the evaluations of this process. With `--runs RUN RUN RUN` the rows
of `pretrained` pool the episodes of several runs, one for each seed. The last row is the upper
bound, as `kinfeas ceiling --json` computes it.
"""

import argparse
import json
from itertools import product
from pathlib import Path

from streams import write_metrics

from kinfeas.core.metrics import wilson
from kinfeas.evaluation.reachability import measure_reachability
from kinfeas.robots.loading import load_robot
from kinfeas.tasks.loading import load_task

EMPTY = ("ggr", "ggr_restricted", "pick_place", "door", "drawer")
TASKS = ("ggr_obstacles", "ggr_dynamic", *EMPTY)
POLICIES = ("pretrained", "planned_base", "whole_body_qp")
FILTERS = (
    (),
    ("obstacle_distance",),
    ("obstacle_distance", "feasibility"),
    ("obstacle_distance", "path_planner", "feasibility"),
)
CEILING = "upper bound"


def main() -> None:
    """Run what is missing, then print what there is."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--robot", default="hsr")
    parser.add_argument("--episodes", type=int, default=500)
    parser.add_argument("--runs", nargs="*", default=POLICIES[:1], help="runs, one for each seed")
    parser.add_argument("--tasks", nargs="*", default=TASKS)
    parser.add_argument("--policies", nargs="*", default=POLICIES)
    parser.add_argument("--filters", nargs="*", type=int, default=range(len(FILTERS)))
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    rows = [FILTERS[number] for number in options.filters]
    for task, policy, filters in product(options.tasks, options.policies, rows):
        for number, run in enumerate(options.runs if policy == POLICIES[0] else [policy]):
            path = options.folder / f"{name(options.robot, task, policy, filters)}-{number}.json"
            write_metrics(path, options.robot, task, run, filters, options.episodes)
    for task in options.tasks:
        path = options.folder / f"{name(options.robot, task, CEILING, ())}-0.json"
        if not path.exists():
            robot, seed = load_robot(options.robot), 1  # as in `configure`
            bound = measure_reachability(robot, load_task(task), options.episodes, seed).share
            path.write_text(json.dumps({"success": bound.value, "episodes": options.episodes}))
    print(table(options.folder, options.robot))


def name(robot: str, task: str, policy: str, filters: tuple[str, ...]) -> str:
    """Return the beginning of the files of an evaluation."""
    return "-".join([robot, task, policy.replace("/", "_").replace(" ", "_"), *filters])


def table(folder: Path, robot: str) -> str:
    """Return the Markdown table of a folder."""
    lines = [f"| success, % | filters | {' | '.join(f'`{task}`' for task in TASKS)} |"]
    lines.append("|---|---|" + "---|" * len(TASKS))
    for policy, filters in [*product(POLICIES, FILTERS), (CEILING, ())]:
        names = [name(robot, task, policy, filters) for task in TASKS]
        cells = [cell(sorted(folder.glob(f"{prefix}-[0-9].json"))) for prefix in names]
        if cells == ["-"] * len(TASKS):
            continue
        lines.append(f"| {policy} | {', '.join(filters)} | {' | '.join(cells)} |")
    return "\n".join(lines)


def cell(files: list[Path]) -> str:
    """Return the success of evaluations with its interval, over all of their episodes."""
    if not files:
        return "-"
    runs = [json.loads(file.read_text()) for file in files]
    episodes = sum(int(run["episodes"]) for run in runs)
    success = wilson(round(sum(run["success"] * run["episodes"] for run in runs)), episodes)
    return f"{100 * success.value:.1f} ({100 * success.low:.1f} - {100 * success.high:.1f})"


if __name__ == "__main__":
    main()
