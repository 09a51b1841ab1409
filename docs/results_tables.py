"""Write the results of `kinfeas benchmark --out DIR` into the documentation.

python docs/results_tables.py DIR...

docs/figures has all cells of the tables, in the format of `table.json`. The cells of each study
replace those of the same robot, task, policy and row. Then docs/reference/tables.md and the
tables of docs/physics.md and README.md are written. A study of all robots in the analytic world
also replaces the pictures.
"""

import io
import json
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from PIL import Image

from kinfeas.benchmark.pictures import table_figure
from kinfeas.benchmark.table import Cell
from kinfeas.viz.style import TITLES, png

DOCS = Path(__file__).parent
README = DOCS.parent / "README.md"
FIGURES = DOCS / "figures"
IMAGES = DOCS / "images"
TASKS = ("ggr", "ggr_restricted", "pick_place", "door", "drawer")
BASELINES = (
    "follow_ee", "follow_ee_feedback", "demonstrated_base", "planned_base",
    "geometric_modulation", "planner", "whole_body_qp",
)  # fmt: skip
PLANNED = ("pretrained", "path planner")
"""Policy and row with the default filters; here the obstacle filter changes nothing."""
LEARNED = {
    ("sac", ""): "SAC, 3 seeds",
    ("pretrained", ""): "pretrained",
    ("pretrained", "feasibility filter"): "pretrained, feasibility filter",
    PLANNED: "pretrained, path planner",
}
"""Rows of learned policies in docs/reference/tables.md."""
PHYSICS = {
    ("pretrained", "head_start"): "{}, 3 s head start",
    ("pretrained", ""): "{}",
}
"""Rows of docs/physics.md, by policy and row."""
IN_PYBULLET = {
    "pr2": ("pretrained", "head_start"),
    "tiago": ("pretrained", ""),
    "hsr": ("pretrained", ""),
}
"""Policy and row of the README's rows with physics."""
HEAD = """\
# Benchmark tables

`python docs/results_tables.py DIR...` writes this page from the results of `kinfeas benchmark`.
[Results](../results.md) and [physics worlds](../physics.md) describe them. The standard deviation
over training seeds is at most 1.2 points; intervals are in [study.json](../figures/study.json),
[physics.json](../figures/physics.json) and [mujoco.json](../figures/mujoco.json).
"""
OF_ANALYTIC = """\
500 episodes. In brackets: EE deviation below 5 cm throughout, and goal reached. *Ceiling*:
reachable goals. The paper's `ggr_restricted` has harder starts, some in
self-collision; "any start" includes them."""
OF_PHYSICS = """\
PyBullet, then MuJoCo; with one number PyBullet. Arm contacts are per episode."""
JUMPS = "Steps in which an arm joint would exceed its velocity limit."
PICTURES = ("learning_curves", "examples-tiago")
COLOURS = 128

Entry = dict[str, Any]
"""A cell in the format of `table.json`."""

Cells = dict[tuple[str, str, str, str], Entry]
"""Cells without a variant, by robot, task, policy and row."""


def merged(record: Sequence[Entry], found: Sequence[Entry]) -> list[Entry]:
    """Return a record with the cells of a study in place of its own or, if new, at its end."""

    def key(cell: Entry) -> tuple[str, ...]:
        return cell["robot"], cell["variant"], cell["task"], cell["policy"], cell["row"]

    return list({key(cell): cell for cell in (*record, *found)}.values())


def plain(record: Sequence[Entry]) -> Cells:
    """Return the cells of a record without a variant."""
    return {
        (cell["robot"], cell["task"], cell["policy"], cell["row"]): cell
        for cell in record
        if not cell["variant"]
    }


def shown(record: Sequence[Entry]) -> list[Cell]:
    """Return the cells of a record in the order of tables: learned first, the paper's once."""
    cells = [Cell(**cell) for cell in record]
    trained = {
        (cell.robot, cell.variant, cell.task)
        for cell in cells
        if cell.policy == "sac" and not cell.row
    }
    once = [
        replace(cell, paper_success=None, paper_within_5cm=None)
        if cell.policy == "pretrained" and (cell.robot, cell.variant, cell.task) in trained
        else cell
        for cell in cells
    ]
    return sorted(once, key=lambda cell: not cell.learned)


def tables_page(record: Sequence[Entry], pybullet: Sequence[Entry], mujoco: Sequence[Entry]) -> str:
    """Return the page with all tables of the records of the three worlds."""
    lines = [HEAD, "## Analytic world", "", OF_ANALYTIC, ""]
    cells = plain(record)
    for robot, title in TITLES.items():
        rows = [(name, *chosen, "success") for chosen, name in LEARNED.items()]
        for policy in BASELINES:
            rows.append((f"`{policy}`", policy, "", "success"))
        rows.insert(1, ("*paper, SAC*", "sac", "", "paper_success"))
        rows.append(("**ceiling**", *PLANNED, "ceiling"))
        table = [
            (name, [_success(cells.get((robot, task, policy, row)), key) for task in TASKS])
            for name, policy, row, key in rows
        ]
        lines += [*_table(f"{title}: success, %", TASKS, table), ""]
    lines += ["### Other starts and goals", ""]
    lines += _table("success, %", ("policy", "success", "ceiling"), list(_variants(record)))
    lines += ["", "### Joint jumps per episode", "", JUMPS, ""]
    jumps = [
        (f"{title}, {name}", [_jumps(cells.get((robot, task, *chosen))) for task in TASKS])
        for robot, title in TITLES.items()
        for chosen, name in LEARNED.items()
        if chosen != ("pretrained", "")
    ]
    lines += _table("robot, policy", TASKS, jumps)
    lines += ["", "## Physics worlds", "", OF_PHYSICS, ""]
    lines += [*physics_table(*WITHIN, pybullet, mujoco), ""]
    lines += [*physics_table(*ARM_CONTACTS, pybullet, mujoco), ""]
    return "\n".join(lines)


def fill_readme(page: str, record: Sequence[Entry], physics: Sequence[Entry]) -> str:
    """Return the README with the rows of a record."""
    analytic, with_physics = plain(record), plain(physics)
    for robot, name in TITLES.items():
        in_pybullet = IN_PYBULLET[robot]
        rows = {
            f"**{name}**, ours": (analytic, *PLANNED, "success"),
            f"{name}, paper": (analytic, "sac", "", "paper_success"),
            f"{name}, policy alone": (analytic, "sac", "", "success"),
            f"{name}, ceiling": (analytic, *PLANNED, "ceiling"),
            PHYSICS[in_pybullet].format(f"**{name}** in PyBullet"): (
                with_physics, *in_pybullet, "success",
            ),
            f"{name} in PyBullet, paper": (with_physics, *in_pybullet, "paper_success"),
        }  # fmt: skip
        for head, (cells, policy, row, key) in rows.items():
            values = [_success(cells[robot, task, policy, row], key) for task in TASKS]
            page = _fill(page, head, values)
    return page


def fill_physics(page: str, pybullet: Sequence[Entry], mujoco: Sequence[Entry]) -> str:
    """Return the page of physics with the success in the records of both engines."""
    lines = [*physics_table(*SUCCESS, pybullet, mujoco), "", ""]
    place = re.compile(r"\| success, % \(paper\).*?\n\n(?=Success in PyBullet)", re.DOTALL)
    filled, count = place.subn(lambda _: "\n".join(lines), page, count=1)
    return _found(filled, count, "physics.md: no table of success in its place")


def physics_table(
    head: str,
    tasks: Sequence[str],
    text: Callable[..., str],
    pybullet: Sequence[Entry],
    mujoco: Sequence[Entry],
) -> list[str]:
    """Return the lines of a table with both engines in each cell."""
    engines = plain(pybullet), plain(mujoco)
    rows = []
    for robot, title in TITLES.items():
        for chosen, name in PHYSICS.items():
            both = [[cells.get((robot, task, *chosen)) for cells in engines] for task in tasks]
            if any(both[-1]):
                rows.append((name.format(title), [text(*pair) for pair in both]))
    return _table(head, tasks, rows)


def _table(head: str, columns: Sequence[str], rows: Sequence[tuple[str, list[str]]]) -> list[str]:
    """Return the lines of a table, without rows that have no value."""
    names = [f"`{name}`" if name in TASKS else name for name in columns]
    return [
        f"| {head} | {' | '.join(names)} |",
        f"|{'---|' * (len(columns) + 1)}",
        *(f"| {name} | {' | '.join(cells)} |" for name, cells in rows if any(cells)),
    ]


def _variants(record: Sequence[Entry]) -> Iterator[tuple[str, list[str]]]:
    for cell in record:
        name = LEARNED.get((cell["policy"], cell["row"]), f"`{cell['policy']}`")
        if cell["variant"] and (name in LEARNED.values() or cell["policy"] == "whole_body_qp"):
            where = f"{TITLES[cell['robot']]}, `{cell['task']}`, {cell['variant']}"
            yield where, [name, _success(cell, "success"), f"{100 * cell['ceiling']:.1f}"]


def _success(cell: Entry | None, key: str) -> str:
    """Return a percentage; for learned policies also the one within 5 cm, in brackets."""
    if cell is None or cell[key] is None:
        return ""
    if key == "ceiling":
        return f"{100 * cell[key]:.1f}"
    if cell["policy"] in BASELINES:
        return _share(cell, key)
    within = cell[key.replace("success", "within_5cm")]
    return f"{_share(cell, key)} ({100 * within:.1f})"


def _jumps(cell: Entry | None) -> str:
    return "" if cell is None else f"{cell['joint_jumps_per_episode']:.2f}"


def _with_paper(*engines: Entry | None) -> str:
    return _pair(engines, "success") + _of_paper(engines[0], "paper_success")


def _within(*engines: Entry | None) -> str:
    return _pair(engines, "within_5cm") + _of_paper(engines[0], "paper_within_5cm")


def _physical(*engines: Entry | None) -> str:
    contacts = [cell["arm_collisions"] for cell in engines if cell]
    return (
        f"{_pair(engines, 'task_success')} ({', '.join(f'{contact:.1f}' for contact in contacts)})"
    )


SUCCESS = ("success, % (paper)", TASKS, _with_paper)
WITHIN = ("within 5 cm, % (paper)", TASKS, _within)
ARM_CONTACTS = ("task success, % (arm contacts)", TASKS[2:], _physical)
"""Heads, tasks and entries of the tables of physics worlds."""


def _pair(engines: Sequence[Entry | None], key: str) -> str:
    """Return the percentages of the engines."""
    return ", ".join(f"{100 * cell[key]:.0f}" for cell in engines if cell)


def _of_paper(cell: Entry | None, key: str) -> str:
    return "" if cell is None or cell[key] is None else f" ({100 * cell[key]:.0f})"


def _fill(page: str, head: str, values: list[str]) -> str:
    row = re.compile(rf"^\| {re.escape(head)} \|.*$", re.MULTILINE)
    filled, count = row.subn(lambda _: f"| {head} | {' | '.join(values)} |", page, count=1)
    return _found(filled, count, f"README.md: no row {head!r}")


def _found(filled: str, places: int, complaint: str) -> str:
    """Return the page; exit with an error if there was no place for its tables."""
    if not places:
        raise SystemExit(f"{complaint}; its figures would stay old")
    return filled


def _share(cell: Entry, key: str) -> str:
    text = f"{100 * cell[key]:.1f}"
    return f"**{text}**" if key == "success" and cell["policy"] not in BASELINES else text


def _read(path: Path) -> list[Entry]:
    cells: list[Entry] = json.loads(path.read_text(encoding="utf-8"))
    return cells


def _write(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8")


def _keep(picture: Image.Image, name: str) -> None:
    few = picture.convert("RGB").quantize(COLOURS)
    few.save(IMAGES / f"{name}.png", optimize=True)


def main(studies: Sequence[Path]) -> None:
    """Merge studies into the record, and write it into the documentation."""
    paths = {
        "analytic": FIGURES / "study.json",
        "pybullet": FIGURES / "physics.json",
        "mujoco": FIGURES / "mujoco.json",
    }
    records = {world: _read(path) for world, path in paths.items()}
    for study in studies:
        found = _read(study / "table.json")
        world = found[0]["world"]
        records[world] = merged(records[world], found)
        if world == "analytic" and {cell["robot"] for cell in found} == set(TITLES):
            # Studies without training have no learning curves.
            for name in PICTURES:
                if (study / f"{name}.png").exists():
                    _keep(Image.open(study / f"{name}.png"), name)
    for world, path in paths.items():
        _write(path, json.dumps(records[world], indent=1, allow_nan=False) + "\n")
    study_record, pybullet, mujoco = (records[world] for world in paths)
    page = DOCS / "physics.md"
    _write(DOCS / "reference" / "tables.md", tables_page(study_record, pybullet, mujoco))
    _write(README, fill_readme(README.read_text(encoding="utf-8"), study_record, pybullet))
    _write(page, fill_physics(page.read_text(encoding="utf-8"), pybullet, mujoco))
    table = png(table_figure(shown(study_record)), 110)
    _keep(Image.open(io.BytesIO(table)), "benchmark")


if __name__ == "__main__":
    main([Path(argument) for argument in sys.argv[1:]])
