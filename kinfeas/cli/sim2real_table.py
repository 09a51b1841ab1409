"""What adapters cost, for `kinfeas evaluate --adapters`: a table, a picture and JSON."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from kinfeas.cli.output import print_table, progress, share, status

if TYPE_CHECKING:
    from kinfeas.evaluation.evaluate import Summary
    from kinfeas.evaluation.sim2real import Cost, Evaluation, Specs


def weigh(
    run: "Evaluation", name: str, adapters: "Specs", picture: Path | None
) -> tuple["Summary", dict[str, object], Callable[[], None]]:
    """Return what a policy does within adapters.

    Args:
        run: Evaluates the policy within some of them.
        name: What the list is called.
        adapters: The first one innermost.
        picture: Where to draw success along the axes; nowhere if None.

    Returns:
        The figures within all adapters, those of all evaluations, and what prints the table.
    """
    from kinfeas.evaluation.sim2real import (
        AXES,
        evaluations,
        measure_costs,
        measure_sweeps,
        to_json,
    )

    axes = AXES if picture is not None else ()
    count = evaluations(adapters, axes)
    with progress(f"{count} evaluations", count) as advance:

        def counted(some: "Specs") -> "Summary":
            summary = run(some)
            advance(1.0)
            return summary

        costs = measure_costs(counted, adapters)
        sweeps = measure_sweeps(counted, adapters, axes)
    if picture is not None:
        from kinfeas.io.files import write_file
        from kinfeas.viz.plots import sim2real_figure
        from kinfeas.viz.style import png

        title = "{policy} on {task}, robot {robot}, {episodes} episodes".format(**costs[-1].figures)
        with status("drawing"):
            figure = sim2real_figure(f"{title}, {name}", costs, sweeps)
            write_file(picture, png(figure, dpi=130))
    held = {"sim2real": name, **to_json(costs, sweeps)}
    return costs[-1].figures, held, lambda: _show(name, costs)


def _show(name: str, costs: "list[Cost]") -> None:
    rows = []
    for cost in costs:
        found, beside = cost.figures, costs[-1 if cost.left_out else 0].figures
        rows.append(
            [
                cost.label,
                share(found["success"], found["success_low"], found["success_high"]),
                f"{100.0 * (found['success'] - beside['success']):+.1f}"
                if found is not beside
                else "",
                share(found["reached"]),
                f"{1000.0 * found['mean_deviation_m']:.1f} mm",
            ]
        )
    columns = ["adapter", " success", " points", " reached", " deviation"]
    print_table(f"adapters of {name}: points to none or, left out, to all", columns, rows)
