"""A benchmark to read: `table.md`."""

from collections.abc import Callable, Mapping, Sequence
from typing import TypeVar

from kinfeas.benchmark.table import WORLD, Cell
from kinfeas.evaluation.paper import LEARNED, TITLES, paper_figures

C = TypeVar("C", bound=Cell)

NOTHING = "-"
"""What stands where nothing was measured."""


_LEARNED = {"sac": "learned, SAC", "td3": "learned, TD3", "pretrained": "learned, pretrained"}

_AIDS = {"feasibility_filter": "feasibility filter", "rollout_planner": "rollout planner"}
"""Prefixes of a policy's name, in words."""

_HOW = """\
Each cell is the percentage of episodes that reach the goal **without an IK failure**. In \
brackets: EE deviation below 5 cm throughout, and goal reached. `±` is the standard deviation over \
training seeds. The *ceiling* is the percentage of goals that are reachable from at least one base \
pose, with its 95 % interval. Rows in italics are the paper's figures, from its own program. Its \
`ggr_restricted` has harder start configurations: in self-collision at these heights, and any \
others beyond them. Tables "any start" use these starts, too."""


_CAPTIONS = {
    "table.png": "Episodes without a failure",
    "learning_curves.png": "Learning curves: mean and standard deviation over the training seeds",
    "workspace.png": "Where in the base frame the end-effector goes, from above and from the side",
}


def to_markdown(
    cells: Sequence[Cell], note: str, commands: Sequence[str], pictures: Sequence[str] = ()
) -> str:
    """Return the tables of a benchmark as Markdown.

    Args:
        cells: What was found.
        note: A sentence above the tables; may be empty.
        commands: Lines that make all of it again.
        pictures: Files to show, relative to the text.
    """
    lines = []
    for robot, variant in groups(cells):
        own = [cell for cell in cells if (cell.robot, cell.variant) == (robot, variant)]
        lines += [f"## {title(robot, variant)}", "", *_success_table(own), ""]
    lines += ["## Joint jumps per episode", "", _JUMPS, "", *_jump_table(cells), ""]
    for name in pictures:
        caption = _CAPTIONS.get(name, "An episode of each task")
        lines += [f"![{caption}]({name})", "", f"*{caption}.*", ""]
    return page("Benchmark", note, [_HOW, _effort(cells)], lines, commands)


def page(
    heading: str, note: str, about: Sequence[str], lines: Sequence[str], commands: Sequence[str]
) -> str:
    """Return the text of a benchmark.

    Args:
        heading: What it is called.
        note: A sentence above all else; may be empty.
        about: Paragraphs on what the tables show.
        lines: The tables, and what else there is to see.
        commands: Lines that make all of it again.
    """
    told = [f"**{note}**", *about] if note else about
    opening = [line for paragraph in (f"# {heading}", *told) for line in (paragraph, "")]
    closing = ["## How to make it again", "", "```sh", *commands, "```", ""]
    return "\n".join([*opening, *lines, *closing])


_JUMPS = "Steps in which an arm joint would exceed its velocity limit."


def groups(cells: Sequence[Cell]) -> list[tuple[str, str]]:
    """Return the robots and variants of `cells`, each once, those without a variant first."""
    found = dict.fromkeys(cell.group for cell in cells)
    return sorted(found, key=lambda group: bool(group[1]))


def title(robot: str, variant: str) -> str:
    """Return what a robot, as it is or in a variant, is called."""
    name = TITLES.get(robot, robot)
    return f"{name}, {variant}" if variant else name


def label(cell: Cell) -> str:
    """Return what the row of a cell is called: its policy, and what else is told of it."""
    policy, also = cell.row
    *aids, own = policy.split(":")
    told = [_LEARNED.get(own, own), " and ".join(_AIDS[aid] for aid in aids), also]
    return ", ".join(part for part in told if part)


def _effort(cells: Sequence[Cell]) -> str:
    seeds = sorted({cell.seeds for cell in cells if cell.learned})
    policies = f"{_or(seeds)} training seed{'s' * (seeds != [1])} a policy, " if seeds else ""
    return f"World: {WORLD}; {policies}{episodes_of(cells)} of each, the same for all policies."


def episodes_of(cells: Sequence[Cell]) -> str:
    """Return how many episodes a policy had on a task."""
    return f"{_or(sorted({cell.episodes_per_seed for cell in cells}))} episodes"


def _or(numbers: Sequence[int]) -> str:
    return " or ".join(f"{number:,}" for number in numbers)


def _success_table(cells: Sequence[Cell]) -> list[str]:
    tasks = tasks_of(cells)
    rows = []
    for policy in dict.fromkeys(cell.policy for cell in cells):
        own = {cell.task: cell for cell in cells if cell.policy == policy}
        name = _row_name(next(iter(own.values())))
        rows.append([name, *entries_of(own, tasks, ours)])
        if any(cell.paper_success is not None for cell in own.values()):
            rows.append(["&nbsp;&nbsp;*paper*", *entries_of(own, tasks, papers)])
    rows += _unmatched(cells, tasks)
    ceilings = {cell.task: cell for cell in cells}
    rows.append(["**ceiling**", *entries_of(ceilings, tasks, ceiling_entry)])
    return table(["", *tasks], rows)


def _unmatched(cells: Sequence[Cell], tasks: Sequence[str]) -> list[list[str]]:
    """Return rows for what the paper has and we have not, so that its table stands there whole."""
    robot, variant = cells[0].robot, cells[0].variant
    if variant:
        return []
    known = {task: paper_figures(robot, task, WORLD) for task in tasks}
    names = list(dict.fromkeys(name for figures in known.values() for name in figures))
    rows = []
    for name in names:
        shown = {c.task for c in cells if _named(c) == name and c.paper_success is not None}
        entries = [
            f"*{100 * figures.success:.1f} ({100 * figures.within_5cm:.1f})*"
            if (figures := known[task].get(name)) and task not in shown
            else NOTHING
            for task in tasks
        ]
        if set(entries) != {NOTHING}:
            rows.append([f"*paper: {'learned' if name == LEARNED else name}*", *entries])
    return rows


def _named(cell: Cell) -> str:
    return LEARNED if cell.learned else cell.policy


def _row_name(cell: Cell) -> str:
    if not cell.learned:
        return cell.policy
    seeds = f", {cell.seeds} seeds" if cell.seeds > 1 else ""
    return f"**{label(cell)}**{seeds}"


def tasks_of(cells: Sequence[Cell]) -> list[str]:
    """Return the tasks of `cells`, each once."""
    return list(dict.fromkeys(cell.task for cell in cells))


def entries_of(
    cells: Mapping[str, C], tasks: Sequence[str], entry: Callable[[C], str]
) -> list[str]:
    """Return the entries of a row: of each task what `entry` says of its cell."""
    return [entry(cells[task]) if task in cells else NOTHING for task in tasks]


def ours(cell: Cell) -> str:
    """Return our shares of a cell, per cent."""
    value = f"{100 * cell.success:.1f}"
    if cell.success_std is not None:
        value += f" ± {100 * cell.success_std:.1f}"
    value = f"**{value}**" if cell.learned else value
    return f"{value} ({100 * cell.within_5cm:.1f})"


def papers(cell: Cell) -> str:
    """Return the paper's."""
    if cell.paper_success is None or cell.paper_within_5cm is None:
        return NOTHING
    return f"*{100 * cell.paper_success:.1f} ({100 * cell.paper_within_5cm:.1f})*"


def ceiling_entry(cell: Cell) -> str:
    """Return the ceiling of a cell with its interval, per cent."""
    ends = f"{100 * cell.ceiling_low:.1f} - {100 * cell.ceiling_high:.1f}"
    return f"{100 * cell.ceiling:.1f} ({ends})"


def _jump_table(cells: Sequence[Cell]) -> list[str]:
    tasks = tasks_of(cells)
    rows = []
    for robot, variant in groups(cells):
        of_group = [cell for cell in cells if (cell.robot, cell.variant) == (robot, variant)]
        for policy in dict.fromkeys(cell.policy for cell in of_group):
            own = {cell.task: cell for cell in of_group if cell.policy == policy}
            entries = entries_of(own, tasks, lambda cell: f"{cell.joint_jumps_per_episode:.2f}")
            rows.append([title(robot, variant), label(next(iter(own.values()))), *entries])
    return table(["robot", "policy", *tasks], rows, names=2)


def table(heads: Sequence[str], rows: Sequence[Sequence[str]], names: int = 1) -> list[str]:
    """Return a Markdown table, aligned in plain text, too: `names` columns left, others right."""
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
