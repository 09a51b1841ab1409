"""Sweeps: each trial is a training job with values of a recipe's keys, drawn by Optuna.

The study is a journal file in the folder of the sweep, so that workers of any engine share it. The
driver creates all trials; the worker of a trial draws its values, trains and reports.
"""

import json
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import optuna
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend
from optuna.trial import Trial, TrialState

from kinfeas import config
from kinfeas.config import Settings, nested
from kinfeas.config.recipes import find_recipe
from kinfeas.config.registry import from_anywhere
from kinfeas.core.errors import KinfeasError
from kinfeas.core.files import reading, writing
from kinfeas.core.quantities import Count, Seed
from kinfeas.jobs.job import Job, Result, finish_training
from kinfeas.training.config import TrainConfig, load_recipe
from kinfeas.training.run import Progress

SETTINGS, RECIPE, BEST = "sweep.yaml", "recipe.yaml", "best.yaml"
"""Files of a sweep: its settings, the recipe, and that of its best trial."""


@dataclass(frozen=True)
class Dimension:
    """Values of one key: choices, or the numbers of a range."""

    choices: tuple[object, ...] = ()  # values to choose from
    low: int | float | None = None  # lowest number of a range; integer ends give integers
    high: int | float | None = None  # highest number
    log: bool = False  # draw the logarithm of the number evenly
    # choices that keys above this one must have; otherwise it has no value
    when: dict[str, object] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check that there are values."""
        if (self.low is None) != (self.high is None) or (self.low is None) != bool(self.choices):
            raise ValueError("a dimension has 'choices', or 'low' and 'high'")
        if self.low is not None and self.high is not None and self.low >= self.high:
            raise ValueError("'low' must be below 'high'")
        if self.log and self.low is not None and self.low <= 0:
            raise ValueError("'low' must be above 0 with 'log'")

    def draw(self, key: str, trial: Trial) -> object:
        """Return the value of a trial."""
        if self.low is None or self.high is None:
            # Optuna takes no lists, so that choices are JSON.
            choices = [json.dumps(choice) for choice in self.choices]
            return json.loads(trial.suggest_categorical(key, choices))
        if isinstance(self.low, int) and isinstance(self.high, int):
            return trial.suggest_int(key, self.low, self.high, log=self.log)
        return trial.suggest_float(key, self.low, self.high, log=self.log)


@dataclass(frozen=True)
class SweepConfig:
    """The schema of `configs/sweep`."""

    space: dict[str, Dimension]  # keys of the recipe and their values
    robot: str = "pr2"  # name or YAML file; its section `train` is the recipe by default
    # name or file of another recipe; its robot, if it names one, replaces `robot`
    recipe: str | None = None
    # values by key of the recipe, for all trials
    settings: dict[str, object] = field(default_factory=dict)
    # number of trials. The first one has the recipe's own values, where the space has them
    trials: Count = 20
    # `tpe` learns from finished trials; `random` depends on the seed alone
    sampler: Literal["tpe", "random"] = "tpe"
    # ends trials early: those with evaluations below the `median` of the others, or by `asha`
    pruner: Literal["median", "asha", "none"] = "median"
    seed: Seed = 0  # seed of the sampler

    def __post_init__(self) -> None:
        """Check that trials differ."""
        if not self.space:
            raise ValueError("'space' must have at least one key")


def read_sweep(name: str, settings: Settings | None = None) -> SweepConfig:
    """Return a sweep by its recipe's name or file; raise KinfeasError for a wrong key or value."""
    sweep = config.load(SweepConfig, find_recipe(name, "sweep"), settings)
    sweep = replace(sweep, robot=from_anywhere(sweep.robot))
    keys = list(sweep.space)
    for key, dimension in sweep.space.items():
        ends = [end for end in (dimension.low, dimension.high) if end is not None]
        for value in (*dimension.choices, *ends):
            settings_of(sweep, {key: value})
        for condition, choice in dimension.when.items():
            if condition not in keys[: keys.index(key)]:
                raise KinfeasError(f"{name}: space.{key}.when: {condition!r} is no key above")
            if choice not in (choices := sweep.space[condition].choices):
                raise KinfeasError(
                    f"{name}: space.{key}.when: {condition!r} must be one of "
                    f"{list(choices)}, not {choice!r}"
                )
    return sweep


def settings_of(sweep: SweepConfig, values: Mapping[str, object]) -> TrainConfig:
    """Return the recipe with values of a trial."""
    return load_recipe(sweep.recipe, nested(sweep.settings, values), robot=sweep.robot)


def plan_trials(sweep: SweepConfig, folder: Path) -> list[Job]:
    """Return the jobs of a sweep, after the missing trials have been added to its study.

    Raises:
        KinfeasError: If the folder has a sweep with other settings than the number of trials, or of
            another recipe.
    """
    recipe = settings_of(sweep, {})
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        if (folder / SETTINGS).exists():
            before = config.load(SweepConfig, folder / SETTINGS)
            if replace(before, trials=sweep.trials) != sweep:
                raise KinfeasError(f"{folder}: a sweep with other settings; use another --out")
        file = folder / RECIPE
        if file.exists() and config.load(TrainConfig, file) != recipe:
            raise KinfeasError(f"{folder}: a sweep of another recipe; use another --out")
        config.dump(recipe, file)
        config.dump(sweep, folder / SETTINGS)
    study = open_study(folder)
    for number in range(len(study.trials), sweep.trials):
        study.enqueue_trial(_own_values(sweep) if number == 0 else {})
    trials = range(sweep.trials)
    return [Job(run_trial, (folder, n), folder / "results" / f"{n}.json") for n in trials]


def open_study(folder: Path) -> optuna.Study:
    """Return the study of a sweep; raise KinfeasError if its journal is broken."""
    sweep = config.load(SweepConfig, folder / SETTINGS)
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    pruners: dict[str, optuna.pruners.BasePruner] = {
        "median": optuna.pruners.MedianPruner(n_startup_trials=4, n_warmup_steps=1),
        "asha": optuna.pruners.SuccessiveHalvingPruner(1, reduction_factor=3),
        "none": optuna.pruners.NopPruner(),
    }
    # With a relative path, Optuna never releases the lock of a killed process.
    journal = (folder / "journal.log").resolve()
    try:
        with reading(journal):
            storage = JournalStorage(JournalFileBackend(str(journal)))
            return optuna.create_study(
                study_name="sweep", storage=storage, load_if_exists=True, direction="maximize",
                pruner=pruners[sweep.pruner],
            )  # fmt: skip
    except (LookupError, TypeError, AttributeError, AssertionError) as error:
        raise KinfeasError(f"{journal}: not the journal of a sweep: {error!r}") from error


def run_trial(description: tuple[Path, int]) -> Result:
    """Train or resume a trial of a sweep; return its state, values and metrics."""
    from kinfeas.training.learner import DivergedError

    folder, number = description
    sweep, study = config.load(SweepConfig, folder / SETTINGS), open_study(folder)
    frozen = study.trials[number]
    if frozen.state.is_finished():  # the worker was killed before it wrote the file
        return dict(frozen.user_attrs["result"])
    if frozen.state == TrialState.WAITING:
        study._storage.set_trial_state_values(frozen._trial_id, TrialState.RUNNING)
    trial = Trial(study, frozen._trial_id)
    values = _drawn(sweep, trial)

    def evaluations() -> dict[int, float]:
        return study.trials[number].intermediate_values

    def report(progress: Progress) -> None:
        if progress.evaluations and progress.evaluations not in evaluations():
            trial.report(progress.best, progress.evaluations)
            if progress.fraction < 1.0 and trial.should_prune():
                raise optuna.TrialPruned

    state, metrics = TrialState.COMPLETE, {}
    try:
        run = settings_of(sweep, values), folder / "trials" / str(number)
        metrics = finish_training(run, report)
        metrics["score"] = (metrics["success"] + metrics["tracked_5cm"]) / 2.0
    except optuna.TrialPruned:
        state, metrics["score"] = TrialState.PRUNED, max(evaluations().values())
    except DivergedError as error:
        state, metrics["error"] = TrialState.FAIL, str(error)
    result = {"number": number, "state": state.name.lower(), "values": values, **metrics}
    trial.set_user_attr("result", result)
    study.tell(trial, metrics["score"] if state == TrialState.COMPLETE else None, state)
    return result


def write_best(folder: Path, results: Sequence[Result]) -> Result:
    """Write the recipe of the best trial as `best.yaml`; return the result of this trial.

    Raises:
        KinfeasError: If no trial is complete.
    """
    complete = [result for result in results if result["state"] == "complete"]
    if not complete:
        raise KinfeasError(f"{folder}: no trial is complete")
    best = max(complete, key=lambda result: float(result["score"]))
    sweep = config.load(SweepConfig, folder / SETTINGS)
    with writing(folder):
        config.dump(settings_of(sweep, best["values"]), folder / BEST)
    return best


def importances(folder: Path) -> dict[str, float]:
    """Return the fraction of the score's variance by key; empty if there are too few trials."""
    try:
        with warnings.catch_warnings(action="ignore"):
            return optuna.importance.get_param_importances(open_study(folder))
    except (ValueError, RuntimeError):
        return {}


def _drawn(sweep: SweepConfig, trial: Trial) -> dict[str, object]:
    """Return the values of a trial; those drawn before an interruption stay."""
    values: dict[str, object] = {}
    for index, (key, dimension) in enumerate(sweep.space.items()):
        # A sampler for each value, so that an interruption does not change the next value.
        seed = int(np.random.SeedSequence([sweep.seed, trial.number, index]).generate_state(1)[0])
        trial.study.sampler = (
            optuna.samplers.TPESampler(seed=seed, n_startup_trials=5)
            if sweep.sampler == "tpe"
            else optuna.samplers.RandomSampler(seed=seed)
        )
        if all(values.get(name) == choice for name, choice in dimension.when.items()):
            values[key] = dimension.draw(key, trial)
    return values


def _own_values(sweep: SweepConfig) -> dict[str, object]:
    """Return the recipe's own values of the keys, where they are in the space."""
    own: dict[str, object] = {}
    recipe = config.to_mapping(settings_of(sweep, {}))
    for key, dimension in sweep.space.items():
        value: Any = recipe
        for part in key.split("."):
            if isinstance(value, list):
                value = value[int(part)]
            else:
                value = value.get(part) if isinstance(value, Mapping) else None
        if value in dimension.choices:  # 0.0 equals 0
            own[key] = json.dumps(dimension.choices[dimension.choices.index(value)])
        elif dimension.low is not None and isinstance(value, int | float):
            assert dimension.high is not None
            ends = dimension.low, dimension.high
            integers = all(isinstance(end, int) for end in ends)  # the range has integers only
            if ends[0] <= value <= ends[1] and not (integers and value % 1):
                own[key] = value
    return own
