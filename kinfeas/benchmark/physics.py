"""The table of physics: parts of episodes put together, beside the same without physics."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from kinfeas.benchmark.cells import Result
from kinfeas.benchmark.job import Job
from kinfeas.benchmark.records import from_lists
from kinfeas.benchmark.table import Cell, common, interval, mean_of
from kinfeas.core.metrics import Metrics, Share, join, summarize
from kinfeas.evaluation.paper import LEARNED, PaperFigures, paper_figures
from kinfeas.robots.loading import load_robot


@dataclass(frozen=True)
class PhysicsCell(Cell):
    """A cell of the table of physics; its `variant` names the row, and is empty for the plain one.

    Attributes:
        analytic_success: Share of success in the analytic world, in as many of the same episodes.
        analytic_within_5cm: Likewise.
        task_success: Share in which the objects ended as the task wants them; the share that came
            to the goal where it wants nothing of them, and null without objects.
        task_success_low: Lower end of its 95 % interval.
        task_success_high: Upper end.
        base_collisions: How often an episode the base ran into something.
        arm_collisions: How often the arm did.
        collision_free_rate: Share of episodes without either.
        time_scale: Speed of the EE motions as a share of the planned one.
        head_start: Seconds that the EE stood still at first.
        filters: Names of the command filters.
        objects: Whether the scene was there.
    """

    analytic_success: float
    analytic_within_5cm: float
    task_success: float | None
    task_success_low: float | None
    task_success_high: float | None
    base_collisions: float
    arm_collisions: float
    collision_free_rate: float
    time_scale: float
    head_start: float
    filters: tuple[str, ...]
    objects: bool

    @property
    def group(self) -> tuple[str, str]:
        """What it stands in one table with: all cells of a robot."""
        return self.robot, ""

    @property
    def row(self) -> tuple[str, str]:
        """What it stands in one row of that table with."""
        return self.policy, self.variant.replace("_", " ")


def tabulate_physics(
    jobs: Sequence[Job], results: Sequence[Result], analytic: Sequence[Cell]
) -> list[PhysicsCell]:
    """Return the cells that parts come to, in the order of the jobs.

    Args:
        jobs: Parts of episodes with physics.
        results: What each of them found.
        analytic: The cells of the same policies on the same tasks in the analytic world.
    """
    groups: dict[tuple[str, str, str, str], dict[str, list[tuple[Job, Result]]]] = {}
    for job, result in zip(jobs, results, strict=True):
        cell = groups.setdefault((job.robot, job.task_name, job.variant, job.policy), {})
        cell.setdefault(job.source, []).append((job, result))
    without = {(cell.robot, cell.task, cell.policy): cell for cell in analytic}
    cells = []
    for (robot, task, _, policy), sources in groups.items():
        beside = without[load_robot(robot).name, task, policy]
        cells.append(_cell(list(sources.values()), beside))
    robots = list(dict.fromkeys(cell.robot for cell in cells))
    # All rows of learned policies together, before the baselines.
    return sorted(cells, key=lambda cell: (robots.index(cell.robot), not cell.learned))


def _cell(sources: Sequence[Sequence[tuple[Job, Result]]], analytic: Cell) -> PhysicsCell:
    """Return the cell of some training seeds, each of them given in parts."""
    job, world = sources[0][0][0], sources[0][0][0].world
    episodes = sum(part.episodes for part, _ in sources[0])
    figures = [
        summarize(join([from_lists(result["records"]) for _, result in parts])) for parts in sources
    ]
    seeds = [parts[0][0].training_seed for parts in sources]
    ceiling = {
        "success": analytic.ceiling, "low": analytic.ceiling_low, "high": analytic.ceiling_high
    }  # fmt: skip
    done = _task_success(figures, episodes)
    whole = replace(job, episodes=episodes)
    return PhysicsCell(
        **common(whole, figures, seeds, ceiling, _paper(analytic, job.variant)),
        world="pybullet",
        analytic_success=analytic.success,
        analytic_within_5cm=analytic.within_5cm,
        task_success=done.value if done else None,
        task_success_low=done.low if done else None,
        task_success_high=done.high if done else None,
        base_collisions=mean_of(figures, "base_collisions"),
        arm_collisions=mean_of(figures, "arm_collisions"),
        collision_free_rate=mean_of(figures, "collision_free_rate"),
        time_scale=world.time_scale,
        head_start=world.head_start,
        filters=tuple(one.name for one in world.filters),
        objects=bool(world.backend_parameters.get("objects", True)),
    )


def _task_success(figures: Sequence[Metrics], episodes: int) -> Share | None:
    """Return the share of tasks done over the training seeds, None where none can be."""
    shares = [share for found in figures if (share := found["task_success"]) is not None]
    return interval(shares, episodes) if shares else None


def _paper(cell: Cell, variant: str) -> PaperFigures | None:
    """Return what the paper has in the same place; its table is of SAC."""
    if cell.policy == "td3":
        return None
    known = paper_figures(cell.robot, cell.task, "physics")
    return known.get(variant or LEARNED if cell.learned else cell.policy)
