"""Metrics of policies, pictures and videos of an episode, and the ceiling of success."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast

from kinfeas.api import DEFAULT_ROBOT, Name, OnProgress, counter
from kinfeas.api.load import Adapters, checked, load_robot, plugin_settings, robot_of, text_of
from kinfeas.api.view import check_files, write_files
from kinfeas.config import Settings, from_mapping, nested
from kinfeas.core.errors import KinfeasError
from kinfeas.core.policy import Policy
from kinfeas.core.quantities import Episodes, Processes, Seed
from kinfeas.envs.episodes import closed
from kinfeas.envs.world import World
from kinfeas.evaluation import evaluate as evaluation
from kinfeas.evaluation.evaluate import EvalConfig, Summary
from kinfeas.evaluation.reachability import ReachabilityConfig, measure_reachability
from kinfeas.io.policy_metadata import read_trained
from kinfeas.planning.placement import STAGES
from kinfeas.policies.loading import load_policy, trained_folder
from kinfeas.policies.network import Network
from kinfeas.policies.onnx_policy import OnnxPolicy
from kinfeas.robots.robot import Robot
from kinfeas.tasks.loading import load_task


class Metrics(Summary, total=False):
    """Metrics of a policy trained for `steps`; `ablation` has those with fewer adapters."""

    steps: int | None
    ablation: dict[str, Summary]


def evaluate(  # noqa: PLR0913 - options of the command
    policy: Name | Policy,
    *,
    robot: Name | None = None,
    task: Name = "ggr",
    world: str = "analytic",
    episodes: int | None = None,
    seed: int = 1,
    filters: str | Sequence[str] | None = None,
    adapters: Adapters | None = None,
    ablation: bool = False,
    picture: Name | None = None,
    video: Name | None = None,
    replay: Name | None = None,
    episode: int = 0,
    processes: int = 1,
    settings: Settings | None = None,
    on_progress: OnProgress | None = None,
) -> Metrics:
    """Return the metrics of a policy, as in the JSON of `kinfeas evaluate`.

    Example: `kinfeas.evaluate("pretrained", robot="pr2", episodes=100)["success"]`

    Args:
        policy: Name, run folder, ONNX file, `module:Class`, or an object with `act`.
        robot: Name or folder; by default the robot of the policy.
        task: Name or YAML file.
        world: Backend: `analytic`, `pybullet`, `mujoco`, or a plugin.
        episodes: Number of episodes; 500 by default, 50 with physics.
        seed: Random seed of the episodes.
        filters: Names of command filters; the robot's by default.
        adapters: Name or YAML file of a list of adapters, or its entries.
        ablation: Whether also no adapter, each one alone, and all but one are evaluated.
        picture: PNG file to write, a drawing of an episode.
        video: GIF or MP4 file to write, a video of it; or PNG file of four frames.
        replay: HTML file to write, an interactive page of it.
        episode: Number of the episode that these files show.
        processes: Number of parallel processes.
        settings: Values by key, such as `world.dt` or `task.KEY`.
        on_progress: Called with a description of the current work and the fraction that is done.

    Returns:
        Metrics by key: `success`, the fraction of episodes that reach the goal without an IK
        failure; `within_5cm`, the fraction in which the EE is always within 5 cm of its path and
        at the end of the goal; `ceiling`, the fraction of reachable goals. The 95 % intervals of
        these have the suffixes `_low` and `_high`. `failed` lists the numbers of failed episodes by
        reason, `per_episode` has columns for `pandas.DataFrame`, and `steps` are those of the
        policy's training, if known. `kinfeas.core.metrics.Metrics` describes the other metrics.

    Raises:
        KinfeasError: If an argument or a setting is invalid.
    """
    name = type(policy).__name__
    if isinstance(policy, str | Path) or not hasattr(policy, "act"):
        name = text_of(policy, "policy")
    elif (robot := robot or getattr(policy, "robot", None)) is None:
        raise KinfeasError("give the 'robot' of a policy that is an object")
    model = load_robot(robot or robot_of(name))
    config = evaluation.configure(
        model, str(task), world, seed=checked(Seed, seed, "seed"),
        episodes=None if episodes is None else checked(Episodes, episodes, "episodes"),
        settings=nested(plugin_settings(filters, adapters, "world."), settings),
    )  # fmt: skip
    driver = load_policy(name, model) if isinstance(policy, str | Path) else policy
    processes = checked(Processes, processes, "processes")
    episode = checked(int, episode, "episode")
    if not 0 <= episode < config.episodes:
        raise KinfeasError(f"'episode' must be in [0, {config.episodes}), not {episode}")
    check_files(picture=picture, video=video, replay=replay)

    def measure(config: EvalConfig, adapters: str) -> Summary:
        text = f"{config.episodes} episodes {adapters}".rstrip()
        count, steps = counter(on_progress, text, config.episodes), itertools.count(1)

        def watch(*_: object) -> None:  # progress within an episode, which may take minutes
            count(0.0, f", {next(steps) * config.world.dt:.0f} s simulated")

        return evaluation.evaluate(config, driver, name, processes, count, watch)

    metrics = cast("Metrics", measure(config, ""))
    metrics["steps"] = _steps(policy, driver, model)
    if ablation:
        metrics["ablation"] = {
            label: measure(replace(config, world=replace(config.world, adapters=subset)), label)
            for label, subset in evaluation.adapter_subsets(config.world.adapters).items()
        }
    # After the evaluations, which raise errors of the configuration at once.
    summaries = (metrics, *metrics.get("ablation", {}).values())
    evaluation.add_ceiling(summaries, config, counter(on_progress, "ceiling"))
    if picture or video or replay:
        counter(on_progress, f"episode {episode}")
        from kinfeas.viz.replay import run_episode

        with closed(again := World(config.robot, config.task, config.world, config.seed)):
            shown = run_episode(again, driver, episode)
        write_files(shown, model, picture, video, replay, on_progress=on_progress)
    return metrics


def _steps(policy: Name | Policy, driver: Policy, robot: Robot) -> int | None:
    """Return the steps of a policy's training; None if unknown."""
    if isinstance(driver, OnnxPolicy):
        return cast("int | None", driver.metadata.training.get("steps"))
    if isinstance(driver, Network) and isinstance(policy, str | Path):
        return read_trained(trained_folder(str(policy), robot)).steps
    return None


@dataclass(frozen=True)
class Ceiling:
    """The fraction of reachable goals: an upper bound of the success of every policy."""

    robot: str  # name of the robot
    task: str  # name of the task
    seed: int  # seed of the goals
    episodes: int  # number of episodes
    path: bool  # whether poses on the way to each sub-goal count, too
    ceiling: float  # fraction of episodes of which all sub-goals are reachable
    ceiling_low: float  # lower end of its 95 % interval
    ceiling_high: float  # upper end
    base_poses: tuple[int, ...]  # numbers of base poses that were tried for each goal
    convergence: tuple[float, ...]  # fraction reachable with each of these numbers of base poses
    # for each sub-goal, the number of episodes in which it is out of reach, by limit
    out_of_reach: tuple[dict[str, int], ...]


def ceiling(  # noqa: PLR0913 - options of the command
    robot: Name = DEFAULT_ROBOT,
    *,
    task: Name = "ggr",
    episodes: int = 500,
    seed: int = 1,
    path: bool = False,
    settings: Settings | None = None,
    on_progress: OnProgress | None = None,
) -> Ceiling:
    """Return the fraction of goals that some base pose reaches.

    Example: `kinfeas.ceiling("pr2", task="door", episodes=100).ceiling`

    Arguments are the options of the command. `settings` are values by key, such as `ik.restarts`.

    Raises:
        KinfeasError: If an argument or a setting is invalid, or the targets of the task move.
    """
    config = from_mapping(ReachabilityConfig, {}, "settings", settings)
    model, goals = load_robot(robot), load_task(str(task), config.task)
    count, seed = checked(Episodes, episodes, "episodes"), checked(Seed, seed, "seed")
    path = checked(bool, path, "path")
    reached = measure_reachability(
        model, goals, count, seed, config.ik,
        counter(on_progress, f"{episodes} goals"), path=path, limits=True,
    )  # fmt: skip
    fraction = reached.share
    return Ceiling(
        model.name, goals.name, seed, count, path, fraction.value, fraction.low, fraction.high,
        STAGES, reached.convergence, reached.limits,
    )  # fmt: skip
