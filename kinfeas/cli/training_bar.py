"""How a training run shows how far it has come."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from kinfeas.cli.output import LINE_SECONDS, minutes

if TYPE_CHECKING:
    from kinfeas.training.run import Progress


@contextmanager
def training_bar() -> Iterator[Callable[["Progress"], None]]:
    """Show a bar on standard error, lines if that is no terminal; yield what updates it."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn

    console = Console(stderr=True)
    if not console.is_terminal:
        yield _Lines()
        return
    columns = (
        TextColumn("training"),
        BarColumn(),
        TaskProgressColumn(),
        TextColumn("{task.fields[news]}"),
    )
    with Progress(*columns, console=console) as bar:
        task = bar.add_task("training", total=1.0, news="compiling")
        yield lambda progress: bar.update(task, completed=progress.share, news=describe(progress))


def describe(progress: "Progress") -> str:
    """Return one line on a run: steps, speed, success, best evaluation, time to go."""
    left = progress.seconds * (1.0 - progress.share) / max(progress.share, 1e-9)
    # NaN and -1 stand for nothing known yet.
    recent = f"{progress.success:.0%}" if progress.success >= 0.0 else "-"
    best = f"{progress.best:.1%}" if progress.best >= 0.0 else "-"
    if progress.evaluating:
        return f"{progress.steps:,} steps, evaluating (not counted as training time)"
    return (
        f"{progress.steps:,} steps, {progress.steps / max(progress.seconds, 1e-9):,.0f}/s, "
        f"success {recent}, best score {best}, {minutes(left)} left"
    )


class _Lines:
    """Writes a line every now and then."""

    def __init__(self) -> None:
        self.last = -LINE_SECONDS

    def __call__(self, progress: "Progress") -> None:
        now = time.monotonic()
        if now - self.last >= LINE_SECONDS or progress.share >= 1.0 or progress.evaluating:
            self.last = now
            sys.stderr.write(f"{progress.share:4.0%}  {describe(progress)}\n")
            sys.stderr.flush()
