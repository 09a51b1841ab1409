"""The report of `kinfeas demo`: a trained policy beside baselines, ceiling and paper."""

from collections.abc import Callable, Sequence
from pathlib import Path

from kinfeas.core.metrics import Proportion
from kinfeas.envs.world import World
from kinfeas.evaluation.evaluate import EvalConfig, Summary, add_ceiling, evaluate, reachability_of
from kinfeas.evaluation.paper import paper_figures
from kinfeas.evaluation.recording import record_episodes
from kinfeas.policies.loading import QUICK_BASELINES, load_policy
from kinfeas.viz.episodes import episodes_figure
from kinfeas.viz.plots import learning_curve, read_metrics
from kinfeas.viz.report import Report, Row
from kinfeas.viz.style import png

SHOWN = 3
"""Episodes in the picture: the first ones, not the best."""


def compare(
    config: EvalConfig,
    run: Path,
    commands: Sequence[str],
    processes: int = 1,
    on_done: Callable[[float], None] = lambda fraction: None,
) -> tuple[Summary, Report]:
    """Return the metrics of the policy of a run, and its report beside baselines and ceiling.

    `commands` reproduce the report. `on_done` is called with the fraction of all work, 0-1, that
    has just been done.
    """
    work, robot, task = 2 + len(QUICK_BASELINES), config.robot, config.task
    names = (str(run), *QUICK_BASELINES)
    policies = {name: load_policy(name, robot) for name in names}
    count = work * config.episodes
    trained, *baselines = [
        evaluate(config, policy, name, processes, lambda ended: on_done(ended / count))
        for name, policy in policies.items()
    ]
    ceiling = reachability_of(config, lambda fraction: on_done(fraction / work))
    assert ceiling is not None  # no stream of targets
    add_ceiling(trained, ceiling)
    success = _success(trained)
    levels = {metrics["policy"]: _success(metrics).value for metrics in baselines}
    rows = [Row("trained policy", success, trained, ours=True)]
    rows += [Row(metrics["policy"], _success(metrics), metrics) for metrics in baselines]
    rows.append(Row("ceiling", ceiling, {}))
    paper = paper_figures(robot.name, task.name)
    for key, name in (("policy", "paper: learned policy"), ("follow_ee", "paper: follow_ee")):
        if key in paper:
            rows.append(Row(name, Proportion(*[paper[key].success] * 3), {}))
    curve = learning_curve(read_metrics(run), {**levels, "ceiling": ceiling.value})
    world = World(robot, task, config.world, config.seed)
    recordings = record_episodes(world, policies[str(run)], min(SHOWN, config.episodes))
    return trained, Report(
        title=f"A base policy for {robot.name} on {task.name}",
        summary=(
            f"The policy completes {success.value:.1%} of {config.episodes} fresh episodes without "
            f"an IK failure, the better baseline {max(levels.values()):.1%}. At most "
            f"{ceiling.value:.1%} of the goals are reachable."
        ),
        rows=rows,
        notes=(
            f"Episodes 0 to {config.episodes - 1} of seed {config.seed} in all rows except the "
            "paper's, which come from its own program. Intervals are Wilson's.",
            "Ceiling: goals that the end-effector reaches from some base pose.",
        ),
        pictures={
            "Episodes without a failure during training.": png(curve),
            f"The first {len(recordings)} episodes of seed {config.seed}.": png(
                episodes_figure(robot, recordings)
            ),
        },
        commands=commands,
    )


def _success(metrics: Summary) -> Proportion:
    return Proportion(metrics["success"], metrics["success_low"], metrics["success_high"])
