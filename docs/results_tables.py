"""Put the figures of `kinfeas benchmark --out DIR` into docs/results.md, README.md and docs/images.

python docs/results_tables.py DIR
"""

import json
import re
import sys
from pathlib import Path
from typing import Any

from PIL import Image

ROOT = Path(__file__).parents[1]
TASKS = ("ggr", "ggr_restricted", "pick_place", "door", "drawer")
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
PICTURES = {
    "table": "benchmark",
    "learning_curves": "learning_curves",
    "examples-tiago": "examples-tiago",
    "workspace": "workspace",
}
COLOURS = 128

Cells = dict[tuple[str, str, str], dict[str, Any]]


def read_cells(study: Path) -> Cells:
    """Return the cells of a study without its variants, by robot, task and policy."""
    cells = json.loads((study / "table.json").read_text(encoding="utf-8"))
    return {
        (cell["robot"], cell["task"], cell["policy"]): cell
        for cell in cells
        if not cell.get("variant")
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


def main(study: Path) -> None:
    """Write what a study's folder holds into the documentation."""
    results, readme = ROOT / "docs" / "results.md", ROOT / "README.md"
    table = (study / "table.md").read_text(encoding="utf-8")
    results.write_text(fill_results(results.read_text(encoding="utf-8"), table), encoding="utf-8")
    filled = fill_readme(readme.read_text(encoding="utf-8"), read_cells(study))
    readme.write_text(filled, encoding="utf-8")
    for source, name in PICTURES.items():
        picture = Image.open(study / f"{source}.png").convert("RGB").quantize(COLOURS)
        picture.save(ROOT / "docs" / "images" / f"{name}.png", optimize=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
