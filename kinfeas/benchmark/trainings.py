"""What a study has to be trained, and what it takes as it comes with the package."""

import json
from pathlib import Path

from kinfeas.benchmark.study import BenchmarkConfig, Training
from kinfeas.config.recipes import load_recipe, load_section
from kinfeas.core.errors import KinfeasError
from kinfeas.policies import pretrained
from kinfeas.robots.loading import load_robot
from kinfeas.training.config import TrainConfig


def settings_of(training: Training, seed: int) -> TrainConfig:
    """Return the settings of one training run of a study.

    Raises:
        KinfeasError: If its recipe or its settings are wrong.
    """
    said: dict[str, object] = {
        "robot": training.robot,
        "seed": seed,
        "learner.algorithm": training.algorithm,
    }
    if training.steps is not None or training.minutes is not None:
        said |= {"schedule.steps": training.steps, "schedule.minutes": training.minutes}
    own = [f"{key}={json.dumps(value)}" for key, value in said.items()]
    overrides = [*own, *training.settings]
    if training.recipe is None:
        return load_section(TrainConfig, "train", load_robot(training.robot).name, overrides)
    return load_recipe(TrainConfig, training.recipe, "train", overrides)


def to_train(study: BenchmarkConfig, out: Path) -> list[tuple[TrainConfig, Path]]:
    """Return the settings and the folder of each training run that a study stands on.

    Raises:
        KinfeasError: If a robot has to be trained of which the study does not say how, or two runs
            would share a folder.
    """
    if study.policies == "pretrained":
        return []
    wanted = [robot for robot in study.robots if not takes_pretrained(study, robot)]
    known = {training.robot for training in study.trainings}
    if missing := [robot for robot in wanted if robot not in known]:
        raise KinfeasError(
            f"the study has no entry in 'trainings' for {', '.join(missing)}; it has them for: "
            f"{', '.join(sorted(known)) or 'none'}"
        )
    plans = [
        settings_of(training, seed)
        for training in study.trainings
        if training.robot in wanted
        for seed in study.seeds
    ]
    names = [run_name(settings) for settings in plans]
    for name in names:
        if names.count(name) > 1:
            raise KinfeasError(
                f"the study asks for two training runs {name}: robot, algorithm and seed must tell "
                "the entries of 'trainings' apart"
            )
    return [(settings, out / "runs" / name) for settings, name in zip(plans, names, strict=True)]


def takes_pretrained(study: BenchmarkConfig, robot: str) -> bool:
    """Return whether a study judges the policy that comes with the package for `robot`."""
    if study.policies == "train":
        return False
    return study.policies == "pretrained" or load_robot(robot).name in pretrained.robots()


def run_name(settings: TrainConfig) -> str:
    """Return ROBOT-ALGORITHM-SEED."""
    robot = load_robot(settings.robot).name
    return f"{robot}-{settings.learner.algorithm}-{settings.seed}"
