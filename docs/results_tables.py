"""Put the figures of `kinfeas benchmark --out DIR` into the documentation.

python docs/results_tables.py DIR...

docs/figures holds all cells that the pages show, as `table.json` has them. The cells of each study
take the place of those of the same robot, task and policy; then the tables of docs/results.md,
docs/physics.md and README.md are filled with all of them. A study of all robots in the analytic
world brings its pictures, too.
"""

import io
import json
import re
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from PIL import Image

from kinfeas.benchmark.plot import table_figure
from kinfeas.benchmark.table import Cell
from kinfeas.benchmark.text import to_markdown
from kinfeas.policies.loading import BASELINES
from kinfeas.viz.style import png

DOCS = Path(__file__).parent
README = DOCS.parent / "README.md"
FIGURES = DOCS / "figures"
IMAGES = DOCS / "images"
TASKS = ("ggr", "ggr_restricted", "pick_place", "door", "drawer")
RANDOM = ("ggr", "ggr_restricted")
ROBOTS = {"pr2": "PR2", "tiago": "TIAGo", "hsr": "HSR"}
FILTERS = {
    "pr2": ("feasibility filter", "feasibility_filter:pretrained"),
    "tiago": (
        "rollout planner and feasibility filter",
        "rollout_planner:feasibility_filter:pretrained",
    ),
    "hsr": ("rollout planner", "rollout_planner:sac"),
}
"""The best filters of each robot, in words, and the policy with them."""
ROWS = {
    "**{}**, ours": ("sac", "success"),
    "**{}**, {filters}": ("", "success"),
    "{}, paper": ("sac", "paper_success"),
    "{}, `whole_body_qp`": ("whole_body_qp", "success"),
    "{}, ceiling": ("sac", "ceiling"),
}
"""Policies and figures of the README's rows by their heads; no policy: the one with filters."""
PHYSICS = {
    ("head_start", "pretrained"): "{}, 3 s head start",
    ("", "pretrained"): "{}",
    ("", "rollout_planner:pretrained"): "{}, rollout planner",
    ("no_objects", "pretrained"): "{}, no objects",
    ("", "follow_ee"): "{}, `follow_ee`",
    ("", "follow_ee_feedback"): "{}, `follow_ee_feedback`",
    ("", "geometric_modulation"): "{}, `geometric_modulation`",
    ("", "demonstrated_base"): "{}, `demonstrated_base`",
}
IN_PYBULLET = {
    "pr2": ("head_start", "pretrained"),
    "tiago": ("", "rollout_planner:pretrained"),
    "hsr": ("", "pretrained"),
}
"""Variant and policy of the README's rows with physics."""
PICTURES = ("learning_curves", "examples-tiago", "workspace")
COLOURS = 128

Entry = dict[str, Any]
"""A cell as `table.json` has it."""

Cells = dict[tuple[str, str, str], Entry]
"""Cells of one variant, by robot, task and policy."""


def merged(record: Sequence[Entry], found: Sequence[Entry]) -> list[Entry]:
    """Return a record with the cells of a study in place of its own or, if new, at its end."""

    def key(cell: Entry) -> tuple[str, ...]:
        return cell["robot"], cell["variant"], cell["task"], cell["policy"]

    return list({key(cell): cell for cell in (*record, *found)}.values())


def of_variant(record: Sequence[Entry], variant: str) -> Cells:
    """Return the cells of a record that are of one variant."""
    return {
        (cell["robot"], cell["task"], cell["policy"]): cell
        for cell in record
        if cell["variant"] == variant
    }


def shown(record: Sequence[Entry]) -> list[Cell]:
    """Return the cells of a record as tables show them: learned ones first, the paper's once."""
    cells = [Cell(**cell) for cell in record]
    trained = {(cell.robot, cell.variant, cell.task) for cell in cells if cell.policy == "sac"}
    once = [
        replace(cell, paper_success=None, paper_within_5cm=None)
        if cell.policy == "pretrained" and (cell.robot, cell.variant, cell.task) in trained
        else cell
        for cell in cells
    ]
    return sorted(once, key=lambda cell: not cell.learned)


def fill_results(page: str, record: Sequence[Entry]) -> str:
    """Return the page of results with the tables of a record, a heading deeper."""
    table = to_markdown(shown(record), "", [])
    tables = re.search(r"World: analytic;.*(?=\n## How to make it again)", table, re.DOTALL)
    assert tables is not None
    deeper = re.sub(r"^## ", "### ", tables.group(), flags=re.MULTILINE).rstrip()
    place = re.compile(r"World: analytic;.*?(?=\n\n## Learning curves)", re.DOTALL)
    filled, count = place.subn(lambda _: deeper, page, count=1)
    return _found(filled, count, "results.md: no tables before 'Learning curves'")


def fill_readme(page: str, record: Sequence[Entry], physics: Sequence[Entry]) -> str:
    """Return the README with the rows of its tables filled anew."""
    for robot, name in ROBOTS.items():
        filters, filtered = FILTERS[robot]
        cells = of_variant(record, "")
        for head, (policy, key) in ROWS.items():
            values = [_share(cells[robot, task, policy or filtered], key) for task in TASKS]
            page = _fill(page, head.format(name, filters=filters), values)
        variant, policy = IN_PYBULLET[robot]
        cells = of_variant(physics, variant)
        head = PHYSICS[variant, policy].format(f"**{name}** in PyBullet")
        for row, key in ((head, "success"), (f"{name} in PyBullet, paper", "paper_success")):
            page = _fill(page, row, [_share(cells[robot, task, policy], key) for task in TASKS])
    return page


def fill_physics(page: str, record: Sequence[Entry]) -> str:
    """Return the page of physics with the rows of its table filled anew."""
    rows = [
        _physics_row(name.format(title), cells[robot, task, policy])
        for robot, title in ROBOTS.items()
        for (variant, policy), name in PHYSICS.items()
        for cells in [of_variant(record, variant)]
        for task in TASKS
        if (robot, task, policy) in cells
    ]
    place = re.compile(r"(^\| robot \| task \|.*\n\|[-|]+\|\n)(?:\|.*\n)+", re.MULTILINE)
    filled, count = place.subn(lambda found: found[1] + "\n".join(rows) + "\n", page, count=1)
    return _found(filled, count, "physics.md: no table that begins with 'robot' and 'task'")


def _fill(page: str, head: str, values: list[str]) -> str:
    row = re.compile(rf"^\| {re.escape(head)} \|.*$", re.MULTILINE)
    filled, count = row.subn(lambda _: f"| {head} | {' | '.join(values)} |", page, count=1)
    return _found(filled, count, f"README.md: no row {head!r}")


def _found(filled: str, places: int, complaint: str) -> str:
    """Return the page, or stop with a complaint if nothing was filled in: its figures are old."""
    if not places:
        raise SystemExit(f"{complaint}; its figures would stay old")
    return filled


def _share(cell: Entry, key: str) -> str:
    text = f"{100 * cell[key]:.1f}"
    return f"**{text}**" if key == "success" and cell["policy"] not in BASELINES else text


def _physics_row(name: str, cell: Entry) -> str:
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


def _read(path: Path) -> list[Entry]:
    cells: list[Entry] = json.loads(path.read_text(encoding="utf-8"))
    return cells


def _write(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8")


def _keep(picture: Image.Image, name: str) -> None:
    few = picture.convert("RGB").quantize(COLOURS)
    few.save(IMAGES / f"{name}.png", optimize=True)


def main(studies: Sequence[Path]) -> None:
    """Write what studies hold into the record, and the record into the documentation."""
    analytic, physics = FIGURES / "study.json", FIGURES / "physics.json"
    records = {"analytic": _read(analytic), "pybullet": _read(physics)}
    for study in studies:
        found = _read(study / "table.json")
        world = found[0]["world"]
        records[world] = merged(records[world], found)
        if world == "analytic" and {cell["robot"] for cell in found} == set(ROBOTS):
            # Who trains nothing has no learning curves.
            for name in PICTURES:
                if (study / f"{name}.png").exists():
                    _keep(Image.open(study / f"{name}.png"), name)
    for path, record in zip((analytic, physics), records.values(), strict=True):
        _write(path, json.dumps(record, indent=1, allow_nan=False) + "\n")
    results, page = DOCS / "results.md", DOCS / "physics.md"
    _write(results, fill_results(results.read_text(encoding="utf-8"), records["analytic"]))
    _write(README, fill_readme(README.read_text(encoding="utf-8"), *records.values()))
    _write(page, fill_physics(page.read_text(encoding="utf-8"), records["pybullet"]))
    table = png(table_figure(shown(records["analytic"])), 110)
    _keep(Image.open(io.BytesIO(table)), "benchmark")


if __name__ == "__main__":
    main([Path(argument) for argument in sys.argv[1:]])
