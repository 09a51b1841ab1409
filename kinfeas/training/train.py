"""A training run: collect, learn, evaluate, save; and resume after any interruption."""

import math
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor
from contextlib import closing, contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.spaces import flatdim
from numpy.typing import NDArray

from kinfeas import config as configuration
from kinfeas.config import Settings
from kinfeas.control.observation import surroundings_columns
from kinfeas.core.errors import KinfeasError
from kinfeas.core.extras import require
from kinfeas.core.files import find_folder, locked, write_folder, writing
from kinfeas.core.metrics import summarize
from kinfeas.envs.episodes import worker_pool
from kinfeas.io.policy_metadata import read_best, read_trained
from kinfeas.policies.network import Network, copy_network, read_network, write_network
from kinfeas.training.config import TrainConfig
from kinfeas.training.learner import (
    check_finite,
    explore,
    learn,
    load_learner,
    make_learner,
    network_of,
    save_learner,
    take_network,
    without_denormals,
)
from kinfeas.training.logs import LEARNER, Logs
from kinfeas.training.run import (
    EVALUATION,
    SETTINGS,
    Progress,
    check_begun,
    check_run_folder,
    content_hashes,
    evaluation_seconds,
    evaluations_due,
    fraction_done,
    identity,
    initial_policy,
    loading,
    read_progress,
    read_settings,
    with_initial_policy,
)
from kinfeas.training.vec_env import environments
from kinfeas.training.worlds import (
    EVALUATION_SEED,
    FRESH_SEED,
    evaluate_network,
    has_first_part,
    part_of,
    training_world,
)

LOG_SECONDS = 2.0

Report = Callable[[Progress], None]


def train(config: TrainConfig, out: Path, report: Report | None = None) -> Progress:
    """Train from the beginning and return the progress.

    `out` is the new folder of the run; `report` is called every few seconds.

    Raises:
        KinfeasError: If the folder exists with something in it, or cannot be written.
    """
    check_run_folder(out)
    # Errors of the configuration are raised here, before anything is written.
    config = with_initial_policy(config)
    with closing(_Run(config, out, report)) as run:
        run.begin()
        with writing(out):
            out.mkdir(parents=True, exist_ok=True)
        with locked(out):
            check_run_folder(out)  # another run may have begun there since
            configuration.dump(config, out / SETTINGS)
            return run.go()


def resume(out: Path, report: Report | None = None, settings: Settings | None = None) -> Progress:
    """Resume a run from its last checkpoint and return the progress.

    `report` is called every few seconds. `settings` are values by key such as `schedule.steps`,
    kept in the run's configuration.

    Raises:
        KinfeasError: If the folder is no run, its checkpoint is broken, its robot has other
            kinematics, or another process runs it.
    """
    check_begun(out)
    with locked(out), closing(_Run(read_settings(out, settings), out, report)) as run:
        run.load()
        if settings:
            configuration.dump(run.config, out / SETTINGS)
        return run.go()


class _Run:
    def __init__(self, config: TrainConfig, out: Path, report: Report | None) -> None:
        self.begun = time.monotonic()
        require(*config.trackers)  # each has the name of its package
        self.config, self.out, self.report = config, out, report or (lambda _: None)
        self.limited = evaluation_seconds(config, 1) < math.inf
        analytic = has_first_part(config)
        self.progress = Progress(analytic=analytic)
        self.part = part_of(config, analytic=analytic)
        self.env = environments(self.part)
        self.hashes = content_hashes(config)  # files may change later
        if analytic:  # raises errors of the later world at once
            training_world(config).close()
        self.learner = make_learner(config.learner, self.env, config.seed)
        self.observation: NDArray[np.float32] | None = None
        self.pool: Executor | None = None

    def begin(self) -> None:
        """Take the weights of the initial policy, if there is one."""
        if self.config.init is not None:
            kept = find_folder(self.out / "checkpoints" / "initial")
            if kept.is_dir():  # the other run may have changed, or be gone
                network = read_network(kept, self.env.robot)
            else:
                network = initial_policy(self.config, self.env.scale)
            around = surroundings_columns(self.env.robot, self.env.observation_terms)
            take_network(self.learner, network, self.config.learner.anchor, around)

    def load(self) -> None:
        """Load the last checkpoint, or begin if there is none."""
        self.begin()
        last, best = (find_folder(self.out / "checkpoints" / name) for name in ("last", "best"))
        if not last.is_dir():
            if best.is_dir():
                raise KinfeasError(f"{last}: missing, the run cannot be resumed")
            return
        self.progress = read_progress(self.config, last)
        self._enter()
        with loading(last):
            read_network(last, self.env.robot)
            self.env.reset()
            snapshot = load_learner(last, self.learner, self.env.snapshot())
            self.observation = self.env.restore(snapshot)

    def go(self) -> Progress:
        """Run to the end; an interruption leaves a checkpoint behind."""
        self.begun -= self.progress.seconds + self.progress.other_seconds
        with (
            Logs(self.out, self.config, self._logged()) as self.logs,
            without_denormals(),
            worker_pool(self.config.processes) if self.limited else nullcontext() as self.pool,
        ):
            try:
                self._loop()
                self._evaluate_best()
            except KeyboardInterrupt:
                if self.observation is not None:
                    self._save()
                raise
        return self.progress

    def close(self) -> None:
        """Close the environments of the current part of the run."""
        self.env.close()

    def _loop(self) -> None:
        if self.observation is None:
            self._first()
        start = time.monotonic() - self.progress.seconds
        logged = saved = self.progress.seconds
        while True:
            # First, so that an interrupted evaluation is repeated.
            if evaluations_due(self.config, self.progress) > self.progress.evaluations:
                begun = time.monotonic()
                self._evaluate()
                if self.limited:
                    self.progress.evaluating_seconds += time.monotonic() - begun
                self._clock()
                self._save()
                # Evaluations do not count as training time.
                start = time.monotonic() - self.progress.seconds
                saved = self.progress.seconds
                continue  # with physics, the evaluation may have used up the run's time
            if self.progress.fraction >= 1.0:
                break
            if self.progress.analytic and self.progress.fraction >= self.config.schedule.analytic:
                with uninterrupted():
                    self.progress.analytic, self.observation = False, None
                    self._enter()
                    self._compile()
                    self._clock()
                    self._save()
                start = time.monotonic() - self.progress.seconds
            with uninterrupted():
                with self._timed("step"):
                    self._step()
                self.progress.seconds = now = time.monotonic() - start
                self._clock()
            if now - saved >= self.config.schedule.checkpoint_seconds:
                self._save()
                saved = now
            if now - logged >= LOG_SECONDS:
                self.logs.write(self._row())
                logged = now
                self.report(self.progress)
        self.report(self.progress)

    def _logged(self) -> int:
        """Return the steps up to which `metrics.csv` is kept; a due evaluation is written again."""
        again = evaluations_due(self.config, self.progress) > self.progress.evaluations
        return max(self.progress.steps - again, 0)

    def _clock(self) -> None:
        """Update the fraction and the time left; with physics, start and evaluations count."""
        if self.limited:
            now = time.monotonic() - self.begun
            self.progress.other_seconds = max(now - self.progress.seconds, 0.0)
        self.progress.fraction = done = fraction_done(self.config, self.progress)
        left = self.progress.seconds * (1.0 - done) / max(done, 1e-9)
        self.progress.left_seconds = max(self._left(), 0.0) if self.limited else left

    def _enter(self) -> None:
        """Build the environments of the current part of the run, if it has just begun."""
        part = part_of(self.config, analytic=self.progress.analytic)
        if part != self.part:
            self.env.close()
            self.part, self.env = part, environments(part)

    def _first(self) -> None:
        """Begin the first episodes, and write what a run needs to be resumed."""
        self._compile()
        if self.config.init is not None:
            self._write("initial", lambda folder: self._write_policy(folder, {"steps": 0}))
        # Before the first `best`, so that a run with a `best` can always be resumed.
        self._save()

    def _compile(self) -> None:
        """Begin the first episodes; compile the kernels, which does not count as training time."""
        self.env.reset()
        snapshot = self.env.snapshot()
        self.env.step(np.zeros((self.env.num_envs, flatdim(self.env.action_space))))
        self.observation = self.env.restore(snapshot)

    def _step(self) -> None:
        """Step all environments once, and learn from the replay buffer."""
        config, learner, progress = self.part.learner, self.learner, self.progress
        observation, self.observation = self.observation, None  # a broken step is not saved
        assert observation is not None
        filling = progress.steps < max(config.learning_starts, self.config.num_envs)
        random = filling and self.config.init is None
        action = explore(learner, observation, random=random)
        # The world is stepped in its own thread while the learner trains.
        self.env.step_async(action)
        if not filling:
            first = config.learning_starts + config.critic_steps  # from then on the actor learns
            frozen = self.config.init is not None and progress.steps < first
            learner.actor.requires_grad_(not frozen)
            learner._current_progress_remaining = 1.0 - progress.fraction
            with self._timed("update"):
                learn(learner, config)
        with self._timed("waiting"):
            following, rewards, dones, infos = self.env.step_wait()
        after, ended = following.copy(), np.flatnonzero(dones)
        for row in ended:
            after[row] = infos[row]["terminal_observation"]
        learner.replay_buffer.add(observation, after, action, rewards, dones, infos)
        self.observation = following
        progress.steps += self.part.num_envs * self.part.action_repeat
        progress.ended(infos[row]["is_success"] for row in ended)

    def _evaluate(self) -> None:
        """Evaluate the policy on fixed episodes; keep it as `best` if none was better."""
        self._losses()
        schedule, due = self.config.schedule, evaluations_due(self.config, self.progress)
        network = network_of(self.learner, self.env)
        left = due * evaluation_seconds(self.config, schedule.evaluation_episodes)
        left -= self.progress.evaluating_seconds
        late = self.progress.best >= 0.0 and left <= 0.0 and self.progress.fraction < 1.0
        if late or self._is_evaluated(network):
            self.progress.evaluations = due
            self.logs.write(self._row())
            return
        if self.limited and self.progress.fraction >= 1.0:
            left = self._left() - evaluation_seconds(self.config, schedule.final_episodes)
        figures = self._measure(network, schedule.evaluation_episodes, EVALUATION_SEED, left)
        with uninterrupted():
            self.progress.evaluations, self.progress.evaluated_at = due, self.progress.steps
            score = (figures["success"] + figures["tracked_5cm"]) / 2.0
            if score >= self.progress.best:
                self.progress.best = float(score)
                about = {
                    "config": configuration.to_mapping(self.config),
                    "steps": self.progress.steps,
                    "evaluation": figures,
                }
                # In an extended run, the file is that of the best policy before.
                with writing(self.out):
                    (self.out / EVALUATION).unlink(missing_ok=True)
                self._write("best", lambda folder: self._write_policy(folder, about))
            row = {f"evaluation/{key}": float(value) for key, value in figures.items()}
            self.logs.write(self._row() | row)

    def _is_evaluated(self, network: Network) -> bool:
        """Return whether the network is that of the last evaluation, or that of the best one."""
        if self.progress.best < 0.0:
            return False
        evaluated, best = self.progress.evaluated_at, read_best(self.out).steps
        if best is None or best > evaluated:  # written before a kill, after the last checkpoint
            return False
        return evaluated == self.progress.steps or network.equals(
            read_network(self.out, self.env.robot)
        )

    def _left(self) -> float:
        """Return the seconds to the end of a run whose `minutes` include evaluations."""
        assert self.config.schedule.minutes is not None
        return 60.0 * self.config.schedule.minutes - (time.monotonic() - self.begun)

    def _measure(
        self, network: Network, episodes: int, seed_offset: int, seconds: float
    ) -> dict[str, int | float]:
        """Return the metrics of episodes, and report how many have ended about once a second."""
        done, reported = 0, -math.inf

        def count(ended: int) -> None:
            nonlocal done, reported
            done += ended
            if time.monotonic() - reported >= 1.0:
                self.report(replace(self.progress, evaluating=(done, episodes)))
                reported = time.monotonic()

        count(0)
        records = evaluate_network(
            self.config, network, episodes, seed_offset, count, seconds, self.pool
        )
        metrics: Mapping[str, Any] = summarize(records)
        # None for metrics that the backend does not measure.
        return {key: value for key, value in metrics.items() if value is not None}

    def _evaluate_best(self) -> None:
        """Evaluate the best policy on episodes that did not select it."""
        best = find_folder(self.out / "checkpoints" / "best")
        trained, network = read_trained(best), read_network(best, self.env.robot)
        if trained.fresh_evaluation:
            return
        left = self._left() if self.limited else math.inf
        episodes = self.config.schedule.final_episodes
        figures = self._measure(network, episodes, FRESH_SEED, left)
        self._clock()
        updated = replace(trained, fresh_evaluation=figures)
        copy_network(best, updated, self.out / "checkpoints" / "best")
        fresh = {f"fresh/{key}": float(value) for key, value in figures.items()}
        self.logs.track(fresh, self.progress.steps)

    def _row(self) -> dict[str, float]:
        p = self.progress
        row = {"steps": p.steps, "seconds": p.seconds, "train/success": p.success}
        return row | self._losses()

    def _losses(self) -> dict[str, float]:
        """Return the figures that the learner logged last; raise DivergedError if not finite."""
        values = self.learner.logger.name_to_value
        losses = {key: float(values[key]) for key in LEARNER if key in values}
        check_finite(all(map(math.isfinite, losses.values())), self.config.learner)
        return losses

    def _save(self) -> None:
        self._losses()
        state = {"config": identity(self.config), "hashes": self.hashes}
        state["progress"] = self.progress.saved()

        def fill(folder: Path) -> None:
            save_learner(folder, self.learner, self.env.snapshot(), state)
            self._write_policy(folder, {"steps": self.progress.steps})

        with self._timed("checkpoint"):
            self._write("last", fill)

    @contextmanager
    def _timed(self, part: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        self.progress.parts[part] += time.perf_counter() - start

    def _write(self, name: str, fill: Callable[[Path], None]) -> None:
        write_folder(self.out / "checkpoints" / name, fill)

    def _write_policy(self, folder: Path, about: dict[str, Any]) -> None:
        network = network_of(self.learner, self.env)
        write_network(network, folder, self.env.robot, about)


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Delay SIGINT (Ctrl-C) and SIGTERM until the block is complete."""
    if threading.current_thread() is not threading.main_thread():
        yield  # Python delivers no signals here
        return
    received: list[int] = []
    numbers = signal.SIGINT, signal.SIGTERM
    before = [signal.signal(number, lambda got, _: received.append(got)) for number in numbers]
    try:
        yield
    finally:
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, handler)
        if received:  # also where the block raises
            signal.raise_signal(received[0])
