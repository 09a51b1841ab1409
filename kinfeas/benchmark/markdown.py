"""The results table of a benchmark in Markdown: `table.md`."""

from collections.abc import Callable, Mapping, Sequence

from kinfeas.benchmark.table import Cell
from kinfeas.viz.style import TITLES

NOTHING = "-"
"""Entry of a table where nothing was measured."""

_LEARNED = {"sac": "learned, SAC", "pretrained": "learned, pretrained"}

_HOW = """\
Each cell is the percentage of episodes that reach the goal **without an IK failure**. In \
brackets: EE deviation below 5 cm throughout, and goal reached. `±` is the standard deviation over \
training seeds. The *ceiling* is the percentage of goals that are reachable from at least one base \
pose, with its 95 % interval. Rows in italics are the paper's figures, from its own program, \
without our command filters."""

_PHYSICS = """\
*without physics*: the same policy in the same episodes of the analytic world. *head start*: the \
base moves for 3 s before the EE; *no objects*: an empty floor."""

_JUMPS = "Steps in which an arm joint would exceed its velocity limit."

_DONE = """\
Percentage of episodes in which the objects end as the task asks for, with 95 % intervals: the \
box is on the place table, the door open beyond 60 degrees, the drawer beyond 0.15 m. Tasks \
without objects count the goals reached."""

_COLLISIONS = """\
Collisions of the base / the arm per episode; in brackets the percentage of episodes without any."""

_DEVIATION = "Mean distance of the EE from the desired position, mm."

_CAPTIONS = {
    "table.png": "Episodes without a failure",
    "learning_curves.png": "Learning curves of the training seeds",
}

_PAPER_ROWS = ("head_start", "no_objects")
"""Rows that do not differ from the plain row without physics."""

Entry = Callable[[Cell], str]


def to_markdown(
    cells: Sequence[Cell], note: str, command: str, pictures: Sequence[str] = ()
) -> str:
    """Return the tables of a benchmark as Markdown, with the command that produces them.

    `pictures` are files to show, relative to the text.
    """
    world, worlds = cells[0].world, list(dict.fromkeys(cell.world for cell in cells))
    named = "" if world == "analytic" else f" in {' and '.join(worlds)}"
    lines = [f"# Benchmark{named}", ""]
    lines += [f"**{note}**", ""] if note else []
    lines += [_HOW, "", *([] if world == "analytic" else [_PHYSICS, ""])]
    episodes = sorted({f"{cell.episodes_per_seed:,}" for cell in cells})
    lines += [f"{' or '.join(episodes)} episodes of each policy, the same for all.", ""]
    lines += success_tables(cells)
    for heading, about, entry in _METRICS:
        if any(entry(cell) != NOTHING for cell in cells):
            lines += [f"## {heading}", "", about, "", *_metric_table(cells, entry), ""]
    for name in pictures:
        caption = _CAPTIONS.get(name, "An episode of each task")
        lines += [f"![{caption}]({name})", "", f"*{caption}.*", ""]
    return "\n".join([*lines, "## How to make it again", "", "```sh", command, "```", ""])


def success_tables(cells: Sequence[Cell]) -> list[str]:
    """Return the lines of the tables of success, one for each robot and variant."""
    lines = []
    for robot, variant in groups(cells):
        group = [cell for cell in cells if (cell.robot, cell.variant) == (robot, variant)]
        lines += [f"## {title(robot, variant)}", "", *_success_table(group), ""]
        lines += [*_filters(group), ""]
    return lines


def groups(cells: Sequence[Cell]) -> list[tuple[str, str]]:
    """Return robots and variants of `cells`, each once, those without a variant first."""
    titles = dict.fromkeys((cell.robot, cell.variant) for cell in cells)
    return sorted(titles, key=lambda group: bool(group[1]))


def title(robot: str, variant: str) -> str:
    """Return the title of a robot's table."""
    name = TITLES.get(robot, robot)
    return f"{name}, {variant}" if variant else name


def label(cell: Cell) -> str:
    """Return the name of the row of a cell: its policy and the label of the row."""
    engine = "" if cell.world == "analytic" else cell.world
    parts = [_LEARNED.get(cell.policy, cell.policy), cell.row.replace("_", " "), engine]
    return ", ".join(part for part in parts if part)


def rows_of(cells: Sequence[Cell]) -> list[dict[str, Cell]]:
    """Return the rows of a table in order, each as a mapping from task to cell."""
    rows: dict[tuple[str, str, str], dict[str, Cell]] = {}
    for cell in cells:
        rows.setdefault((cell.policy, cell.row, cell.world), {})[cell.task] = cell
    return list(rows.values())


def _success_table(cells: Sequence[Cell]) -> list[str]:
    tasks = list(dict.fromkeys(cell.task for cell in cells))
    rows: list[list[str]] = []
    for by_task in rows_of(cells):
        first = next(iter(by_task.values()))
        seeds = f", {first.seeds} seeds" if first.seeds > 1 else ""
        name = f"**{label(first)}**{seeds}" if first.learned else label(first)
        rows.append([name, *_entries(by_task, tasks, _measured)])
        below = [("*paper*", _of_paper)]
        if first.row not in _PAPER_ROWS:
            below.append(("without physics", _of_analytic))
        for text, entry in below:
            entries = _entries(by_task, tasks, entry)
            if set(entries) != {NOTHING}:
                rows.append([f"&nbsp;&nbsp;{text}", *entries])
    ceilings = {cell.task: cell for cell in cells}
    rows.append(["**ceiling**", *_entries(ceilings, tasks, _ceiling)])
    return table(["", *tasks], rows)


def _filters(cells: Sequence[Cell]) -> list[str]:
    """Return a line for each set of command filters, with the rows that have it."""
    rows: dict[str, dict[str, None]] = {}
    for cell in cells:
        rows.setdefault(", ".join(cell.filters) or "none", {})[label(cell)] = None
    return [f"* Filters {names}: {'; '.join(labels)}" for names, labels in rows.items()]


def _metric_table(cells: Sequence[Cell], entry: Entry) -> list[str]:
    tasks = list(dict.fromkeys(cell.task for cell in cells))
    rows = []
    for robot, variant in groups(cells):
        group = [cell for cell in cells if (cell.robot, cell.variant) == (robot, variant)]
        for by_task in rows_of(group):
            first = next(iter(by_task.values()))
            rows.append([title(robot, variant), label(first), *_entries(by_task, tasks, entry)])
    return table(["robot", "policy", *tasks], rows, names=2)


def _entries(cells: Mapping[str, Cell], tasks: Sequence[str], entry: Entry) -> list[str]:
    return [entry(cells[task]) if task in cells else NOTHING for task in tasks]


def _percent(*values: float | None) -> str:
    """Return the first fraction in percent, with the others in brackets."""
    if None in values:
        return NOTHING
    first, *others = (f"{100 * value:.1f}" for value in values if value is not None)
    return f"{first} ({' - '.join(others)})"


def _measured(cell: Cell) -> str:
    value = f"{100 * cell.success:.1f}"
    if cell.success_std is not None:
        value += f" ± {100 * cell.success_std:.1f}"
    value = f"**{value}**" if cell.learned else value
    return f"{value} ({100 * cell.within_5cm:.1f})"


def _of_paper(cell: Cell) -> str:
    entry = _percent(cell.paper_success, cell.paper_within_5cm)
    return entry if entry == NOTHING else f"*{entry}*"


def _of_analytic(cell: Cell) -> str:
    return _percent(cell.analytic_success, cell.analytic_within_5cm)


def _ceiling(cell: Cell) -> str:
    return _percent(cell.ceiling, cell.ceiling_low, cell.ceiling_high)


def _done(cell: Cell) -> str:
    return _percent(cell.task_success, cell.task_success_low, cell.task_success_high)


def _collisions(cell: Cell) -> str:
    if cell.collision_free_rate is None:
        return NOTHING
    free = f"({100 * cell.collision_free_rate:.1f})"
    return f"{cell.base_collisions:.2f} / {cell.arm_collisions:.2f} {free}"


def _deviation(cell: Cell) -> str:
    if cell.world == "analytic" or cell.mean_deviation_m is None:
        return NOTHING
    return f"{1000 * cell.mean_deviation_m:.1f}"


_METRICS: tuple[tuple[str, str, Entry], ...] = (
    ("Joint jumps per episode", _JUMPS, lambda cell: f"{cell.joint_jumps_per_episode:.2f}"),
    ("Tasks done", _DONE, _done),
    ("Collisions", _COLLISIONS, _collisions),
    ("Deviation", _DEVIATION, _deviation),
)
"""Heading, explanation and entry of the tables below those of success."""


def table(heads: Sequence[str], rows: Sequence[Sequence[str]], names: int = 1) -> list[str]:
    """Return the lines of an aligned Markdown table: `names` columns left, others right."""
    widths = [max(len(row[i]) for row in (heads, *rows)) for i in range(len(heads))]

    def line(cells: Sequence[str]) -> str:
        padded = [
            text.ljust(width) if i < names else text.rjust(width)
            for i, (text, width) in enumerate(zip(cells, widths, strict=True))
        ]
        return f"| {' | '.join(padded)} |"

    rules = [
        "-" * width if i < names else f"{'-' * (width - 1)}:" for i, width in enumerate(widths)
    ]
    return [line(heads), line(rules), *(line(row) for row in rows)]
