"""The table of physics to read: `table.md` of a benchmark in the PyBullet world."""

from collections.abc import Callable, Sequence

from kinfeas.benchmark.physics import PhysicsCell
from kinfeas.benchmark.text import (
    NOTHING,
    ceiling_entry,
    entries_of,
    episodes_of,
    label,
    ours,
    page,
    papers,
    table,
    tasks_of,
)
from kinfeas.evaluation.paper import TITLES

_INDENT = "&nbsp;&nbsp;"

_HOW = """\
Each cell: per cent of episodes in the PyBullet world, at 50 Hz, that reach the goal **without a \
single kinematic failure**, in brackets the share in which the end-effector, measured from the \
joints, never strays more than 5 cm and ends at the goal. *Without physics* is what the same \
policy reaches in the same episodes of the analytic world. Rows in italics are the paper's own, \
from its own simulator. *head start*: the base moves for 3 s before the end-effector does; *no \
objects*: an empty floor. The *ceiling* is the share of goals that the end-effector \
reaches from some base pose, with its 95 % interval."""

_DONE = """\
Per cent of episodes in which the objects ended as the task wants them, with 95 % intervals: the \
box stands on the place table, the door is open beyond 60 degrees, the drawer beyond 0.15 m. On \
tasks without objects, the goal was reached."""

_COLLIDED = """\
How often an episode the base / the arm ran into something, and in brackets the per cent of \
episodes without either. The policy sees no obstacles."""

_DEVIATED = "Mean distance of the end-effector from where it should be, mm."


def physics_markdown(
    cells: Sequence[PhysicsCell], note: str, commands: Sequence[str], pictures: Sequence[str] = ()
) -> str:
    """Return the tables of a benchmark in the PyBullet world as Markdown.

    Args:
        cells: What was found.
        note: A sentence above the tables; may be empty.
        commands: Lines that make all of it again.
        pictures: Files to show, relative to the text.
    """
    lines = []
    for robot in dict.fromkeys(cell.robot for cell in cells):
        own = [cell for cell in cells if cell.robot == robot]
        lines += [f"## {_title(own[0])}", "", *_success_table(own), ""]
    lines += ["## Tasks done", "", _DONE, "", *_every(cells, _done), ""]
    lines += ["## Collisions", "", _COLLIDED, "", *_every(cells, _collided), ""]
    lines += ["## Deviation", "", _DEVIATED, "", *_every(cells, _deviated), ""]
    for name in pictures:
        lines += [f"![Episodes without a failure, with physics]({name})", ""]
    effort = f"{episodes_of(cells)} of each policy, the same for all."
    return page("Benchmark in the PyBullet world", note, [_HOW, effort], lines, commands)


def _title(cell: PhysicsCell) -> str:
    name = TITLES.get(cell.robot, cell.robot)
    if cell.time_scale == 1.0:
        return name
    return f"{name}, end-effector motions at {cell.time_scale:g} of the planned speed"


def _success_table(cells: Sequence[PhysicsCell]) -> list[str]:
    tasks = tasks_of(cells)
    rows = []
    for row in dict.fromkeys(cell.row for cell in cells):
        own = {cell.task: cell for cell in cells if cell.row == row}
        first = next(iter(own.values()))
        name = f"**{label(first)}**" if first.learned else label(first)
        rows.append([name, *entries_of(own, tasks, ours)])
        if any(cell.paper_success is not None for cell in own.values()):
            rows.append([f"{_INDENT}*paper*", *entries_of(own, tasks, papers)])
        if not first.variant:
            rows.append([f"{_INDENT}without physics", *entries_of(own, tasks, _analytic)])
    of_task = {cell.task: cell for cell in cells}
    rows.append(["**ceiling**", *entries_of(of_task, tasks, ceiling_entry)])
    return table(["", *tasks], rows)


def _every(cells: Sequence[PhysicsCell], entry: Callable[[PhysicsCell], str]) -> list[str]:
    """Return a table of all robots and rows."""
    tasks, rows = tasks_of(cells), []
    for robot, row in dict.fromkeys((cell.robot, cell.row) for cell in cells):
        own = {cell.task: cell for cell in cells if (cell.robot, cell.row) == (robot, row)}
        name = label(next(iter(own.values())))
        rows.append([TITLES.get(robot, robot), name, *entries_of(own, tasks, entry)])
    return table(["robot", "policy", *tasks], rows, names=2)


def _analytic(cell: PhysicsCell) -> str:
    return f"{100 * cell.analytic_success:.1f} ({100 * cell.analytic_within_5cm:.1f})"


def _done(cell: PhysicsCell) -> str:
    low, high = cell.task_success_low, cell.task_success_high
    if cell.task_success is None or low is None or high is None:
        return NOTHING
    return f"{100 * cell.task_success:.1f} ({100 * low:.1f} - {100 * high:.1f})"


def _collided(cell: PhysicsCell) -> str:
    both = f"{cell.base_collisions:.2f} / {cell.arm_collisions:.2f}"
    return f"{both} ({100 * cell.collision_free_rate:.1f})"


def _deviated(cell: PhysicsCell) -> str:
    return f"{1000 * cell.mean_deviation_m:.1f}"
