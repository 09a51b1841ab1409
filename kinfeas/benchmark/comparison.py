"""A trained policy beside the baselines, the ceiling and the paper: figures, pictures, report."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from kinfeas.core.metrics import Share
from kinfeas.envs.world import World
from kinfeas.evaluation.evaluate import EvalConfig, Summary, evaluate, reachability_of
from kinfeas.evaluation.recording import record_episodes
from kinfeas.policies.loading import QUICK_BASELINES, load_policy
from kinfeas.policies.network import read_network
from kinfeas.viz.episodes import episodes_figure
from kinfeas.viz.plots import learning_curve, read_metrics
from kinfeas.viz.report import Picture, Report, Row, paper_success
from kinfeas.viz.style import png

SHOWN = 3
"""Episodes in the picture: the first ones, not the best."""


@dataclass(frozen=True)
class Comparison:
    """What was found in the same episodes.

    Attributes:
        trial: Which episodes.
        run: Folder of the trained policy.
        policy: Its figures.
        baselines: Those of each baseline, by name.
        ceiling: Share of the goals that some base pose can reach.
    """

    trial: EvalConfig
    run: Path
    policy: Summary
    baselines: dict[str, Summary]
    ceiling: Share


def compare(
    trial: EvalConfig, run: Path, processes: int = 1, on_done: Callable[[float], None] | None = None
) -> Comparison:
    """Return how a trained policy does beside the baselines and the ceiling.

    Args:
        trial: What all of them are put to.
        run: Folder of the trained policy.
        processes: How many processes share the episodes; no figure depends on it.
        on_done: Called with the share of all work, 0-1, that has just been done.
    """
    work = 2 + len(QUICK_BASELINES)

    def done(share: float) -> None:
        if on_done is not None:
            on_done(share / work)

    def judge(name: str) -> Summary:
        policy = load_policy(name, trial.robot)
        return evaluate(
            trial, policy, name, ceiling, processes, lambda ended: done(ended / trial.episodes)
        )

    ceiling = reachability_of(trial, done)
    baselines = {name: judge(name) for name in QUICK_BASELINES}
    return Comparison(trial, run, judge(str(run)), baselines, ceiling)


def make_report(comparison: Comparison, commands: Sequence[str]) -> Report:
    """Return the report of a comparison.

    Args:
        comparison: What was found.
        commands: Lines that make all of it again.
    """
    trial, success = comparison.trial, success_of(comparison.policy)
    robot, task = trial.robot.name, trial.task.name
    best = max(success_of(figures).value for figures in comparison.baselines.values())
    return Report(
        title=f"A base policy for {robot} on {task}",
        summary=(
            f"Without a single kinematic failure it completes {success.value:.1%} of "
            f"{trial.episodes} fresh episodes; the better baseline completes {best:.1%}, "
            f"and no policy can complete more than {comparison.ceiling.value:.1%}."
        ),
        rows=_rows(comparison),
        notes=(
            f"Episodes 0 to {trial.episodes - 1} of seed {trial.seed}, the same for all rows but "
            "the paper's, which come from its own program. Intervals are Wilson's.",
            "Ceiling: goals that the end-effector reaches from some base pose.",
        ),
        pictures=_pictures(comparison),
        commands=commands,
    )


def success_of(figures: Summary) -> Share:
    """Return the share of episodes without a failure with its interval."""
    return Share(figures["success"], figures["success_low"], figures["success_high"])


def _rows(comparison: Comparison) -> list[Row]:
    rows = [Row("trained policy", success_of(comparison.policy), comparison.policy, ours=True)]
    rows += [Row(name, success_of(found), found) for name, found in comparison.baselines.items()]
    rows.append(Row("ceiling", comparison.ceiling, {}))
    return rows + [Row(name, Share(v, v, v), {}) for name, v in _paper(comparison).items()]


def _paper(comparison: Comparison) -> dict[str, float]:
    known = paper_success(comparison.trial.robot.name, comparison.trial.task.name)
    names = {"policy": "paper: learned policy", "follow_ee": "paper: follow_ee"}
    return {names[key]: known[key] for key in names if key in known}


def _pictures(comparison: Comparison) -> list[Picture]:
    trial = comparison.trial
    levels = {name: success_of(found).value for name, found in comparison.baselines.items()}
    levels["ceiling"] = comparison.ceiling.value
    curve = learning_curve(read_metrics(comparison.run), levels)
    world = World(trial.robot, trial.task, trial.world, trial.seed)
    policy = read_network(comparison.run, trial.robot)
    shown = record_episodes(world, policy, min(SHOWN, trial.episodes))
    return [
        Picture("Episodes without a failure during training.", png(curve)),
        Picture(
            f"The first {len(shown)} episodes of seed {trial.seed}: the robot at a few moments, "
            "the later the darker, and below the same from above, with a bar from the base to the "
            "end-effector.",
            png(episodes_figure(trial.robot, shown)),
        ),
    ]
