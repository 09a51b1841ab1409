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
    ("pr2", "head_start", "pretrained"): "PR2, 3 s head start",
    ("pr2", "", "pretrained"): "PR2",
    ("tiago", "", "pretrained"): "TIAGo",
    ("tiago", "", "look_ahead:pretrained"): "TIAGo, looking ahead",
    ("hsr", "", "pretrained"): "HSR",
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
    filled, count = place.subn(lambda _: deeper, page, count=1)
    return _found(filled, count, "results.md: no tables before 'How they learn'")


def fill_readme(page: str, cells: Cells) -> str:
    """Return the README with the rows of its table filled anew."""
    for robot, name in ROBOTS.items():
        for rows, entry in ((ROWS, _share), (JUMPS, _jumps)):
            for head, policy in rows.items():
                values = [entry(cells, robot, task, policy) for task in TASKS]
                page = _fill(page, head.format(name), values)
    return page


def _fill(page: str, head: str, values: list[str]) -> str:
    row = re.compile(rf"^\| {re.escape(head)} \|.*$", re.MULTILINE)
    filled, count = row.subn(lambda _: f"| {head} | {' | '.join(values)} |", page, count=1)
    return _found(filled, count, f"README.md: no row {head!r}")


def _found(filled: str, places: int, complaint: str) -> str:
    """Return the page, or stop with a complaint if nothing was filled in: its figures are old."""
    if not places:
        raise SystemExit(f"{complaint}; its figures would stay old")
    return filled


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
        _physics_row(name, cells[robot, task, policy])
        for (robot, variant, policy), name in PHYSICS.items()
        for cells in [{k: v for study in studies for k, v in read_cells(study, variant).items()}]
        for task in TASKS
        if (robot, task, policy) in cells
    ]
    place = re.compile(r"(^\| robot \| task \|.*\n\|[-|]+\|\n)(?:\|.*\n)+", re.MULTILINE)
    filled, count = place.subn(lambda found: found[1] + "\n".join(rows) + "\n", page, count=1)
    return _found(filled, count, "physics.md: no table that begins with 'robot' and 'task'")


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
    filled = {
        results: fill_results(results.read_text(encoding="utf-8"), table),
        readme: fill_readme(readme.read_text(encoding="utf-8"), read_cells(study)),
    }
    for path, text in filled.items():
        path.write_text(text, encoding="utf-8")
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
