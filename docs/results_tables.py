"""Put the figures of `kinfeas benchmark --out DIR` into the documentation.

python docs/results_tables.py DIR
python docs/results_tables.py --physics DIR...

The first fills docs/results.md, README.md and docs/images from a study of the analytic world, the
second docs/physics.md from studies of the PyBullet world, where the last that has a cell counts.
"""

import json
import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from PIL import Image

ROOT = Path(__file__).parents[1]
TASKS = ("ggr", "ggr_restricted", "pick_place", "door", "drawer")
RANDOM = ("ggr", "ggr_restricted")
ROBOTS = {"pr2": "PR2", "tiago": "TIAGo", "hsr": "HSR"}
BOLD = ("sac", "look_ahead:sac")
ROWS = {
    "**{}**, ours": "sac",
    "**{}**, ours, looking ahead": "look_ahead:sac",
    "{}, `whole_body_qp`": "whole_body_qp",
    "{}, `follow_ee_feedback`": "follow_ee_feedback",
}
JUMPS = {
    "{}, arm jumps an episode, ours": "sac",
    "{}, arm jumps an episode, looking ahead": "look_ahead:sac",
}
PHYSICS = {
    ("pr2", "head_start"): "PR2, 3 s head start",
    ("pr2", ""): "PR2",
    ("tiago", ""): "TIAGo",
    ("hsr", ""): "HSR",
}
PICTURES = {
    "table": "benchmark",
    "learning_curves": "learning_curves",
    "examples-tiago": "examples-tiago",
    "workspace": "workspace",
}
COLOURS = 128

Cells = dict[tuple[str, str, str], dict[str, Any]]


def read_cells(study: Path, variant: str = "") -> Cells:
    """Return the cells of a study of one variant, by robot, task and policy."""
    cells = json.loads((study / "table.json").read_text(encoding="utf-8"))
    return {
        (cell["robot"], cell["task"], cell["policy"]): cell
        for cell in cells
        if cell["variant"] == variant
    }


def fill_results(page: str, table: str) -> str:
    """Return the page of results with the tables of `table.md`, a heading deeper."""
    tables = re.search(r"World: analytic;.*?\n## Arm jumps.*?(?=\n!\[)", table, re.DOTALL)
    if tables is None:
        raise SystemExit("table.md: no tables of the analytic world")
    deeper = re.sub(r"^## ", "### ", tables.group(), flags=re.MULTILINE).rstrip()
    place = re.compile(r"World: analytic;.*?(?=\n\n## How they learn)", re.DOTALL)
    return place.sub(lambda _: deeper, page, count=1)


def fill_readme(page: str, cells: Cells) -> str:
    """Return the README with the rows of its table filled anew; it has those that it has."""
    for robot, name in ROBOTS.items():
        for head, policy in ROWS.items():
            page = _fill(page, head.format(name), [_share(cells, robot, t, policy) for t in TASKS])
        for head, policy in JUMPS.items():
            page = _fill(page, head.format(name), [_jumps(cells, robot, t, policy) for t in TASKS])
    return page


def _fill(page: str, head: str, values: list[str]) -> str:
    row = re.compile(rf"^\| {re.escape(head)} \|.*$", re.MULTILINE)
    return row.sub(lambda _: f"| {head} | {' | '.join(values)} |", page, count=1)


def _share(cells: Cells, robot: str, task: str, policy: str) -> str:
    if (robot, task, policy) not in cells:
        return ""
    cell = cells[robot, task, policy]
    text = f"{100 * cell['success']:.1f} ({100 * cell['within_5cm']:.1f})"
    return f"**{text}**" if policy in BOLD else text


def _jumps(cells: Cells, robot: str, task: str, policy: str) -> str:
    if (robot, task, policy) not in cells:
        return ""
    return f"{cells[robot, task, policy]['jumps_per_episode']:.2f}"


def fill_physics(page: str, studies: Sequence[Path]) -> str:
    """Return the page of physics with the rows of its table filled anew."""
    rows = [
        _physics_row(name, cells[robot, task, "pretrained"])
        for (robot, variant), name in PHYSICS.items()
        for cells in [{k: v for study in studies for k, v in read_cells(study, variant).items()}]
        for task in TASKS
        if (robot, task, "pretrained") in cells
    ]
    place = re.compile(r"(^\| robot \| task \|.*\n\|[-|]+\|\n)(?:\|.*\n)+", re.MULTILINE)
    return place.sub(lambda found: found[1] + "\n".join(rows) + "\n", page, count=1)


def _physics_row(name: str, cell: dict[str, Any]) -> str:
    def percent(key: str) -> str:
        return "" if cell[key] is None else f"{100 * cell[key]:.0f}"

    interval = f"({percent('success_low')} - {percent('success_high')})"
    paper = "" if cell["paper_success"] is None else f"{100 * cell['paper_success']:.1f}"
    values = (
        name,
        f"`{cell['task']}`",
        cell["episodes_per_seed"],
        f"**{percent('success')}** {interval}",
        percent("analytic_success"),
        paper,
        percent("within_5cm"),
        percent("task_success") if cell["task"] not in RANDOM else "",
        f"{cell['base_collisions']:.1f} / {cell['arm_collisions']:.1f}",
    )
    return f"| {' | '.join(map(str, values))} |"


def main(study: Path) -> None:
    """Write what a study of the analytic world holds into the documentation."""
    results, readme = ROOT / "docs" / "results.md", ROOT / "README.md"
    table = (study / "table.md").read_text(encoding="utf-8")
    results.write_text(fill_results(results.read_text(encoding="utf-8"), table), encoding="utf-8")
    filled = fill_readme(readme.read_text(encoding="utf-8"), read_cells(study))
    readme.write_text(filled, encoding="utf-8")
    for source, name in PICTURES.items():
        picture = Image.open(study / f"{source}.png").convert("RGB").quantize(COLOURS)
        picture.save(ROOT / "docs" / "images" / f"{name}.png", optimize=True)


def main_physics(studies: Sequence[Path]) -> None:
    """Write what studies of the PyBullet world hold into the documentation."""
    page = ROOT / "docs" / "physics.md"
    page.write_text(fill_physics(page.read_text(encoding="utf-8"), studies), encoding="utf-8")


if __name__ == "__main__":
    folders = [Path(argument) for argument in sys.argv[1:] if argument != "--physics"]
    if "--physics" in sys.argv:
        main_physics(folders)
    else:
        main(*folders)
