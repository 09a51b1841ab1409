"""A run's folder, settings and progress, read without torch."""

import hashlib
import json
import math
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryFile
from typing import Annotated, Any

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray
from safetensors import SafetensorError

from kinfeas import config as configuration
from kinfeas.config import Settings
from kinfeas.core.errors import KinfeasError
from kinfeas.core.files import (
    MAX_JSON_BYTES,
    find_folder,
    is_path,
    named_file_hashes,
    read_file,
    reading,
    writing,
)
from kinfeas.core.quantities import NotNegative
from kinfeas.io.policy_metadata import read_best, read_trained
from kinfeas.policies.loading import PRETRAINED, trained_folder, trained_policies
from kinfeas.policies.network import Network, read_network
from kinfeas.robots.loading import load_robot
from kinfeas.robots.robot import fingerprint
from kinfeas.tasks.loading import load_task
from kinfeas.training.config import TrainConfig
from kinfeas.training.worlds import in_evaluation

SETTINGS = "config.yaml"
"""File with the settings of a run, the first that it writes."""

EVALUATION = "evaluation.json"
"""File with the metrics of a finished run."""

STATE = "state.json"
"""File with the numbers of a checkpoint."""

EVALUATIONS = 0.25
"""Fraction of `schedule.minutes` for evaluations with physics."""

_Tally = Annotated[int, Interval(ge=0)]
_RECENT = 256  # training episodes in the reported success rate
_FORMAT = 3
_SAVED = (
    "steps", "seconds", "best", "evaluations", "evaluated_at", "recent", "other_seconds",
    "evaluating_seconds", "analytic",
)  # fmt: skip
_BROKEN = (
    ArithmeticError, LookupError, OSError, RuntimeError, SafetensorError, TypeError, ValueError
)  # fmt: skip


@dataclass
class Progress:
    """Progress of a run."""

    steps: _Tally = 0  # environment steps so far
    seconds: NotNegative = 0.0  # wall-clock time of training so far, over all parts of the run
    fraction: float = 0.0  # fraction of the run that is done, 0-1
    # score of the best checkpoint, the mean of success and of the fraction of episodes with
    # tracking errors below 5 cm, 0-1; -1 before the first one
    best: Annotated[float, Interval(ge=-1.0, le=1.0)] = -1.0
    evaluations: _Tally = 0  # number of evaluations
    evaluated_at: Annotated[int, Interval(ge=-1)] = -1  # steps at the last one; -1 before the first
    # whether each of the last training episodes was without a failure
    recent: tuple[bool, ...] = ()
    # episodes done and episodes in all of the evaluation that runs now
    evaluating: tuple[int, int] | None = None
    # wall-clock seconds of parts in this process: `step`, of which `update` of the networks and
    # `waiting` for the environments; and `checkpoint`
    parts: dict[str, float] = field(default_factory=lambda: defaultdict(float))
    # wall-clock time of start and evaluations, where `schedule.minutes` includes it
    other_seconds: NotNegative = 0.0
    evaluating_seconds: NotNegative = 0.0  # part of it in evaluations, without the final one
    # whether the run is in its part in the analytic world; see `ScheduleConfig`
    analytic: bool = False
    left_seconds: float = 0.0  # estimated wall-clock time to the end of the run

    @property
    def success(self) -> float:
        """Fraction of recent training episodes without a failure; NaN before the first one ends."""
        return float(np.mean(self.recent)) if self.recent else float("nan")

    def ended(self, successes: Iterable[bool]) -> None:
        """Count training episodes that have ended."""
        self.recent = (*self.recent, *successes)[-_RECENT:]

    def saved(self) -> dict[str, object]:
        """Return the fields of a checkpoint."""
        return {name: getattr(self, name) for name in _SAVED}


def check_run_folder(out: Path) -> None:
    """Raise KinfeasError if no run can begin in a folder."""
    with writing(out):
        # Hidden files may be left by a run that was killed while it wrote its first file.
        if out.is_dir() and any(not path.name.startswith(".") for path in out.iterdir()):
            if (out / SETTINGS).is_file():
                raise KinfeasError(f"{out}: holds a run; resume it, or choose another 'out'")
            raise KinfeasError(f"{out}: holds other files; 'out' must be a new or an empty folder")
        nearest = next(folder for folder in (out, *out.parents) if folder.exists())
        TemporaryFile(dir=nearest).close()


def check_begun(out: Path) -> None:
    """Raise KinfeasError if no run has begun in a folder."""
    with reading(out):
        if not (out / SETTINGS).is_file():
            raise KinfeasError(f"{out}: not a training run: there is no {SETTINGS} in it")


def read_settings(out: Path, settings: Settings | None = None) -> TrainConfig:
    """Return the configuration of the run in a folder, changed by settings."""
    check_begun(out)
    return configuration.load(TrainConfig, out / SETTINGS, settings)


def finished(out: Path, settings: Settings | None = None) -> Progress | None:
    """Return the progress of a run that is finished with these settings; None for any other.

    Raises:
        KinfeasError: If the run is beyond the limits of these settings already.
    """
    config, last = read_settings(out, settings), find_folder(out / "checkpoints" / "last")
    if not last.is_dir():
        return None
    progress = read_progress(config, last)
    if progress.fraction >= 1.0 and config.schedule != read_settings(out).schedule:
        minutes = (progress.seconds + progress.other_seconds) / 60.0
        raise KinfeasError(f"{out}: has {progress.steps:,} steps in {minutes:.1f} minutes already")
    ended = progress.fraction >= 1.0 and progress.evaluations >= evaluations_due(config, progress)
    return progress if ended and read_trained(out).fresh_evaluation else None


def read_evaluation(out: Path) -> dict[str, Any]:
    """Return the metrics of a finished run on fresh episodes, and what they were measured on."""
    best, config = read_best(out), read_settings(out)
    return {
        "robot": best.robot,
        "trained_with": config.robot,
        "task": config.task,
        "world": config.world.backend,
        "adapters": [adapter.name for adapter in config.evaluation_adapters],
        "filters": [each.name for each in in_evaluation(config).world.filters],
        "policy": str(out),
        "steps": best.steps,
        **best.fresh_evaluation,
    }


def read_progress(config: TrainConfig, last: Path) -> Progress:
    """Return the progress of a run in its last checkpoint, the folder `last`."""
    state = read_state(last)
    with loading(last):
        # Keys that did not exist when the checkpoint was written have their defaults.
        before = identity(configuration.from_mapping(TrainConfig, state["config"], str(last)))
        now, hashes, written = identity(config), content_hashes(config), state.get("hashes", {})
        for key in hashes.keys() & written.keys():
            if hashes[key] != written[key]:
                raise KinfeasError(
                    f"{last}: trained with another {key}, or {now[key]} has changed since"
                )
            before[key] = now[key]  # it may have moved
        if differences := list(_differences(before, now)):
            its = ", ".join(f"{key} is {value}" for key, value, _ in differences)
            others = ", ".join(other for *_, other in differences)
            raise KinfeasError(
                f"{last}: a checkpoint of another run: its {its}, "
                f"but {last.parents[1] / SETTINGS} has {others}"
            )
        # Fields that did not exist when it was written have their defaults.
        progress = configuration.from_mapping(Progress, state["progress"], str(last / STATE))
    # The schedule may have been made longer.
    progress.fraction = fraction_done(config, progress)
    progress.evaluations = min(progress.evaluations, evaluations_due(config, progress))
    return progress


def evaluation_seconds(config: TrainConfig, episodes: int) -> float:
    """Return the time limit of an evaluation, in seconds; infinity where there is none.

    With physics, `schedule.minutes` includes start and evaluations.
    """
    schedule = config.schedule
    if schedule.minutes is None or config.world.backend == "analytic":
        return math.inf
    planned = schedule.evaluations * schedule.evaluation_episodes + schedule.final_episodes
    return EVALUATIONS * 60.0 * schedule.minutes * episodes / planned


def fraction_done(config: TrainConfig, progress: Progress) -> float:
    """Return the fraction of a run's steps that is done, or of its time if that is more, 0-1."""
    fractions, schedule = [0.0], config.schedule
    if schedule.steps is not None:
        fractions.append(progress.steps / schedule.steps)
    if schedule.minutes is not None:
        last = evaluation_seconds(config, schedule.evaluation_episodes + schedule.final_episodes)
        limit = 60.0 * schedule.minutes - (last if last < math.inf else 0.0)
        fractions.append((progress.seconds + progress.other_seconds) / limit)
    return min(1.0, max(fractions))


def evaluations_due(config: TrainConfig, progress: Progress) -> int:
    """Return the number of evaluations due by now; an initial policy is evaluated as well."""
    return (config.init is not None) + int(progress.fraction * config.schedule.evaluations)


def identity(config: TrainConfig) -> dict[str, object]:
    """Return the settings that must not change on resuming: all but schedule and trackers."""
    mapping = configuration.to_mapping(config)
    return {key: mapping[key] for key in mapping if key not in ("schedule", "trackers")}


def content_hashes(config: TrainConfig) -> dict[str, str]:
    """Return hashes of the robot's kinematics, and of the YAML of a task and files in it, by key.

    Raises:
        KinfeasError: If one of the files is not there.
    """
    for key in ("robot", "task"):
        if is_path(path := getattr(config, key)) and not Path(path).exists():
            raise KinfeasError(f"{key} {path} is not there; give its new place with --{key}")
    hashes = {"robot": fingerprint(load_robot(config.robot))}
    if is_path(config.task):
        task = configuration.to_mapping(load_task(config.task, config.task_parameters))
        text = json.dumps(task, sort_keys=True, ensure_ascii=False)
        text = text.replace(f"{Path(config.task).parent}/", "")  # of the files that it names
        text += "".join(named_file_hashes(task))
        hashes["task"] = f"sha256:{hashlib.sha256(text.encode()).hexdigest()}"
    return hashes


def _differences(first: object, second: object, key: str = "") -> Iterator[tuple[str, str, str]]:
    """Yield keys with dots and both values where nested mappings differ."""
    if isinstance(first, Mapping) and isinstance(second, Mapping):
        for name in sorted({*first, *second}):
            yield from _differences(first.get(name), second.get(name), f"{key}.{name}".strip("."))
    elif first != second:
        yield key, str(first), str(second)


def with_initial_policy(config: TrainConfig, settings: Settings | None = None) -> TrainConfig:
    """Return the configuration with the layers, terms and absolute path of its initial policy.

    Raises:
        KinfeasError: If `settings`, which `config` contains already, set other layers or terms.
    """
    if config.init is None:
        return config
    network = _initial_policy(config)
    terms = network.observation_terms
    net_arch = tuple(len(bias) for bias in network.biases[:-1])
    own = config.init in trained_policies(load_robot(config.robot))
    tuned = replace(
        config,
        init=config.init if own else str(Path(config.init).absolute()),
        observation=(*terms, *(name for name in config.observation if name not in terms)),
        learner=replace(config.learner, net_arch=net_arch),
    )
    asked = configuration.nested(settings)
    explicit = {"observation": asked, "learner.net_arch": asked.get("learner", {})}
    both = configuration.to_mapping(config), configuration.to_mapping(tuned)
    for key, value, own_value in _differences(*both):
        if key.split(".")[-1] in explicit.get(key, ()):
            raise KinfeasError(f"{key!r} is {value}, but with init {config.init} it is {own_value}")
    return tuned


def initial_policy(config: TrainConfig, scale: NDArray[np.float32]) -> Network:
    """Return the policy that a run starts from; raise KinfeasError if its scale differs."""
    network = _initial_policy(config).widened(load_robot(config.robot), config.observation)
    if not np.array_equal(network.scale, scale):
        raise KinfeasError(f"init: {config.init}: its observations have another scale")
    return network


def _initial_policy(config: TrainConfig) -> Network:
    init, robot = config.init or "", load_robot(config.robot)
    folder = trained_folder(init, robot)
    if not init or not folder.is_dir():  # an empty path is the current folder
        raise KinfeasError(
            f"init: {init!r}: neither the folder of a training run or of a checkpoint "
            f"nor {PRETRAINED!r}"
        )
    return read_network(folder, robot)


def write_state(folder: Path, entries: Mapping[str, Any]) -> None:
    """Write the numbers of a checkpoint into an existing folder as JSON."""
    text = json.dumps({"format": _FORMAT, **entries})
    (folder / STATE).write_text(text, encoding="utf-8")


def read_state(folder: Path) -> dict[str, Any]:
    """Return the entries that `write_state` wrote, and the format."""
    with loading(folder):
        about: dict[str, Any] = json.loads(read_file(folder / STATE, MAX_JSON_BYTES))
        if about["format"] != _FORMAT:
            raise ValueError(f"its format is {about['format']}, not {_FORMAT}")
        return about


@contextmanager
def loading(folder: Path) -> Iterator[None]:
    """Raise a `KinfeasError` that names the folder for a missing or broken checkpoint."""
    try:
        yield
    except KinfeasError:
        raise
    except FileNotFoundError as error:
        raise KinfeasError(f"{folder}: no checkpoint to resume: a file is missing") from error
    except _BROKEN as error:
        reason = " ".join(str(error).split())[:200]
        raise KinfeasError(
            f"{folder}: broken checkpoint, or one of another run: {type(error).__name__}: {reason}"
        ) from error
