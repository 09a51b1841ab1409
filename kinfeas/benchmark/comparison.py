"""The report of `kinfeas demo`: a trained policy beside baselines, ceiling and paper."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from kinfeas.core.metrics import Proportion
from kinfeas.envs.world import World
from kinfeas.evaluation.evaluate import EvalConfig, Summary, evaluate, reachability_of
from kinfeas.evaluation.recording import record_episodes
from kinfeas.policies.loading import QUICK_BASELINES, load_policy
from kinfeas.policies.network import read_network
from kinfeas.viz.episodes import episodes_figure
from kinfeas.viz.plots import learning_curve, read_metrics
from kinfeas.viz.report import Report, Row, paper_success
from kinfeas.viz.style import png

SHOWN = 3
"""Episodes in the picture: the first ones, not the best."""


@dataclass(frozen=True)
class Comparison:
    """Results of the policy of a run and of baselines in the same episodes."""

    config: EvalConfig
    run: Path
    policy: Summary
    baselines: dict[str, Summary]
    ceiling: Proportion


def compare(
    config: EvalConfig,
    run: Path,
    processes: int = 1,
    on_done: Callable[[float], None] | None = None,
) -> Comparison:
    """Return the results of the policy of a run, the baselines and the ceiling.

    `on_done` is called with the share of all work, 0-1, that has just been done.
    """
    work = 2 + len(QUICK_BASELINES)

    def done(fraction: float) -> None:
        if on_done is not None:
            on_done(fraction / work)

    def evaluated(name: str) -> Summary:
        policy = load_policy(name, config.robot)
        return evaluate(
            config, policy, name, ceiling, processes, lambda ended: done(ended / config.episodes)
        )

    ceiling = reachability_of(config, done)
    assert ceiling is not None  # no stream of targets
    baselines = {name: evaluated(name) for name in QUICK_BASELINES}
    return Comparison(config, run, evaluated(str(run)), baselines, ceiling)


def make_report(comparison: Comparison, commands: Sequence[str]) -> Report:
    """Return the report of a comparison, with the commands that produce it."""
    config, success = comparison.config, success_of(comparison.policy)
    robot, task = config.robot.name, config.task.name
    rows = [Row("trained policy", success, comparison.policy, ours=True)]
    rows += [
        Row(name, success_of(summary), summary) for name, summary in comparison.baselines.items()
    ]
    rows.append(Row("ceiling", comparison.ceiling, {}))
    paper = paper_success(robot, task)
    for key, name in (("policy", "paper: learned policy"), ("follow_ee", "paper: follow_ee")):
        if key in paper:
            rows.append(Row(name, Proportion(paper[key], paper[key], paper[key]), {}))
    best = max(success_of(summary).value for summary in comparison.baselines.values())
    return Report(
        title=f"A base policy for {robot} on {task}",
        summary=(
            f"The policy completes {success.value:.1%} of {config.episodes} fresh episodes without "
            f"an IK failure, the better baseline {best:.1%}. At most "
            f"{comparison.ceiling.value:.1%} of the goals are reachable."
        ),
        rows=rows,
        notes=(
            f"Episodes 0 to {config.episodes - 1} of seed {config.seed} in all rows except the "
            "paper's, which come from its own program. Intervals are Wilson's.",
            "Ceiling: goals that the end-effector reaches from some base pose.",
        ),
        pictures=_pictures(comparison),
        commands=commands,
    )


def success_of(metrics: Summary) -> Proportion:
    """Return the share of episodes without a failure with its interval."""
    return Proportion(metrics["success"], metrics["success_low"], metrics["success_high"])


def _pictures(comparison: Comparison) -> dict[str, bytes]:
    config = comparison.config
    levels = {name: success_of(summary).value for name, summary in comparison.baselines.items()}
    levels["ceiling"] = comparison.ceiling.value
    curve = learning_curve(read_metrics(comparison.run), levels)
    world = World(config.robot, config.task, config.world, config.seed)
    policy = read_network(comparison.run, config.robot)
    recordings = record_episodes(world, policy, min(SHOWN, config.episodes))
    return {
        "Episodes without a failure during training.": png(curve),
        f"The first {len(recordings)} episodes of seed {config.seed}.": png(
            episodes_figure(config.robot, recordings)
        ),
    }
