"""A training run: collect, learn, evaluate, save; and go on after any interruption."""

import csv
import time
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch.utils.tensorboard import SummaryWriter

from kinfeas import config as configuration
from kinfeas import registry
from kinfeas.envs.world import World
from kinfeas.errors import KinfeasError
from kinfeas.evaluation.episodes import run_episodes
from kinfeas.metrics import summarize
from kinfeas.policy import write_network
from kinfeas.training.checkpoint import find_folder, load_learner, save_learner, write_folder
from kinfeas.training.config import TrainConfig
from kinfeas.training.learner import explore, make_learner, network_of
from kinfeas.training.vec_env import WorldVecEnv

EVALUATION_SEED = 1_000_003
"""Offset between the seed of training and that of the episodes that pick the best checkpoint."""

RECENT = 256
"""Training episodes that the reported success rate is the mean of."""

LOG_SECONDS = 2.0


@dataclass
class Progress:
    """How far a run has come.

    Attributes:
        steps: Environment steps so far.
        seconds: Wall-clock time so far, over all parts of the run.
        share: Share of the run that is done, 0-1.
        success: Share of recent training episodes without a failure, with exploration and noise.
        best: Success of the best checkpoint in its evaluation, 0-1; -1 before the first one.
        evaluations: How many evaluations there have been.
    """

    steps: int = 0
    seconds: float = 0.0
    share: float = 0.0
    success: float = float("nan")
    best: float = -1.0
    evaluations: int = 0
    recent: deque[bool] = field(default_factory=lambda: deque(maxlen=RECENT))


Report = Callable[[Progress], None]


def train(config: TrainConfig, out: Path, report: Report | None = None) -> Progress:
    """Train from the beginning and return how far it came.

    Args:
        config: What to do.
        out: Folder of the run, made anew.
        report: Called every few seconds.

    Raises:
        KinfeasError: If the folder exists with something in it, or cannot be written.
    """
    if config.schedule.steps is None and config.schedule.minutes is None:
        raise KinfeasError("schedule: one of steps and minutes must be set")
    try:
        if out.is_dir() and any(out.iterdir()):
            raise KinfeasError(f"{out}: already there; use --resume {out}, or another --out")
        (out / "checkpoints").mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise KinfeasError(f"{out}: cannot be written: {error.strerror}") from error
    configuration.dump(config, out / "config.yaml")
    return _Run(config, out).go(report)


def resume(out: Path, report: Report | None = None) -> Progress:
    """Go on with a run from its last checkpoint and return how far it came.

    Raises:
        KinfeasError: If the folder is no run, or its checkpoint is broken.
    """
    if not (out / "config.yaml").is_file():
        raise KinfeasError(f"{out}: not a training run: there is no config.yaml in it")
    run = _Run(configuration.load(TrainConfig, out / "config.yaml"), out)
    if find_folder(out / "checkpoints" / "last").is_dir():
        run.load()
    return run.go(report)


class _Run:
    """One training run in its folder."""

    def __init__(self, config: TrainConfig, out: Path) -> None:
        self.config, self.out = config, out
        robot = registry.load_robot(config.robot)
        task = registry.build("kinfeas.tasks", config.task, config.task_parameters)
        self.env = WorldVecEnv(World(robot, task, config.world, config.seed), config.environments)
        judged = replace(config.world, max_failures=99, adapters=())
        self.judge = World(robot, task, judged, config.seed + EVALUATION_SEED)
        self.learner = make_learner(config.learner, self.env, config.seed)
        self.progress = Progress()
        self.observation: NDArray[np.float32] | None = None
        self.updates = 0

    def load(self) -> None:
        """Take up the last checkpoint."""
        world, state = load_learner(find_folder(self.out / "checkpoints" / "last"), self.learner)
        self.observation = self.env.restore(world)
        saved = state["progress"]
        self.progress = Progress(**{**saved, "recent": deque(saved["recent"], maxlen=RECENT)})

    def go(self, report: Report | None) -> Progress:
        """Run to the end; an interruption leaves a checkpoint behind."""
        with _Logs(self.out, self.progress.steps) as logs:
            try:
                self._loop(logs, report)
            except KeyboardInterrupt:
                self._save()
                raise
            self._save()
        return self.progress

    def _loop(self, logs: "_Logs", report: Report | None) -> None:
        if self.observation is None:
            self.observation = self.env.reset()
        begun = time.monotonic() - self.progress.seconds
        logged = saved = self.progress.seconds
        while self.progress.share < 1.0:
            self._step()
            self.progress.seconds = now = time.monotonic() - begun
            self.progress.share = self._share()
            if self.progress.share * self.config.schedule.evaluations >= self.progress.evaluations + 1:
                logs.write(self._row() | self._evaluate())
                self._save()
                self.progress.seconds = saved = time.monotonic() - begun
            elif now - saved >= self.config.schedule.checkpoint_seconds:
                self._save()
                saved = now
            if now - logged >= LOG_SECONDS:
                logs.write(self._row())
                logged = now
                if report is not None:
                    report(self.progress)
        if report is not None:
            report(self.progress)

    def _step(self) -> None:
        """Step all environments once, and learn from what has been seen."""
        config, learner, progress = self.config.learner, self.learner, self.progress
        assert self.observation is not None
        random = progress.steps < config.random_steps
        action = explore(learner, config, self.observation, random)
        seen, rewards, dones, infos = self.env.step(action)
        after = seen.copy()
        for row in np.flatnonzero(dones):
            after[row] = infos[row]["terminal_observation"]
            progress.recent.append(infos[row]["is_success"])
        assert learner.replay_buffer is not None
        learner.replay_buffer.add(self.observation, after, action, rewards, dones, infos)
        self.observation = seen
        progress.steps += self.config.environments
        progress.success = float(np.mean(progress.recent)) if progress.recent else float("nan")
        if not random:
            learner._current_progress_remaining = 1.0 - progress.share
            learner.train(config.gradient_steps, config.batch_size)

    def _share(self) -> float:
        schedule = self.config.schedule
        shares = [0.0]
        if schedule.steps is not None:
            shares.append(self.progress.steps / schedule.steps)
        if schedule.minutes is not None:
            shares.append(self.progress.seconds / (60.0 * schedule.minutes))
        return min(1.0, max(shares))

    def _evaluate(self) -> dict[str, float]:
        """Judge the policy on fixed episodes; keep it if none was better."""
        network = network_of(self.learner, self.env.scale)
        episodes = self.config.schedule.evaluation_episodes
        figures = summarize(run_episodes(self.judge, network, episodes))
        self.progress.evaluations += 1
        if figures["success"] >= self.progress.best:
            self.progress.best = float(figures["success"])
            about = {
                "config": configuration.to_mapping(self.config),
                "steps": self.progress.steps,
                "evaluation": figures,
            }
            write_folder(
                self.out / "checkpoints" / "best",
                lambda folder: write_network(network, folder, self.env.world.robot, about),
            )
        return {f"evaluation/{key}": float(value) for key, value in figures.items()}

    def _row(self) -> dict[str, float]:
        p = self.progress
        row = {"steps": p.steps, "seconds": p.seconds, "train/success": p.success}
        values = self.learner.logger.name_to_value
        return row | {key: float(values[key]) for key in _LOGGED if key in values}

    def _save(self) -> None:
        progress = {**vars(self.progress), "recent": list(self.progress.recent)}
        robot = self.env.world.robot

        def fill(folder: Path) -> None:
            save_learner(folder, self.learner, self.env.snapshot(), {"progress": progress})
            network = network_of(self.learner, self.env.scale)
            write_network(network, folder, robot, {"steps": self.progress.steps})

        write_folder(self.out / "checkpoints" / "last", fill)


_LOGGED = ("train/actor_loss", "train/critic_loss", "train/ent_coef", "train/learning_rate")
_EVALUATED = ("success", "within_5cm", "mean_failures", "mean_deviation_m", "jumps_per_episode")
_COLUMNS = (
    "steps", "seconds", "train/success", *_LOGGED, *(f"evaluation/{name}" for name in _EVALUATED)
)  # fmt: skip


class _Logs:
    """`metrics.csv` and TensorBoard; rows beyond the step that a run resumes from are dropped."""

    def __init__(self, out: Path, steps: int) -> None:
        path = out / "metrics.csv"
        rows: Iterable[dict[str, Any]] = []
        if path.is_file():
            with path.open(newline="", encoding="utf-8") as file:
                rows = [row for row in csv.DictReader(file) if float(row["steps"]) <= steps]
        self._file = path.open("w", newline="", encoding="utf-8")
        self._table = csv.DictWriter(self._file, _COLUMNS, extrasaction="ignore")
        self._table.writeheader()
        self._table.writerows(rows)
        self._board = SummaryWriter(str(out / "tensorboard"), purge_step=steps)

    def __enter__(self) -> "_Logs":
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()
        self._board.close()

    def write(self, row: dict[str, float]) -> None:
        """Write one row of figures."""
        self._table.writerow(row)
        self._file.flush()
        for key, value in row.items():
            if key != "steps":
                self._board.add_scalar(key, value, int(row["steps"]))
