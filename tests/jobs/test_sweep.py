import json
from dataclasses import replace

import pytest

from kinfeas import config
from kinfeas.core.errors import KinfeasError
from kinfeas.jobs.job import build_engine, run_jobs
from kinfeas.training import train as training
from kinfeas.training.config import TrainConfig
from kinfeas.training.learner import DivergedError
from tests.builders import TRAINING, KilledError, stop_at

optuna = pytest.importorskip("optuna")
sweep = pytest.importorskip("kinfeas.jobs.sweep")

SWEEP = {
    "robot": "hsr",
    "settings": TRAINING | {"schedule.steps": 64, "schedule.minutes": None},
    "space": {
        "learner.learning_rate": {"low": 1e-4, "high": 1e-3, "log": True},
        "learner.batch_size": {"choices": [16, 32]},
        "learner.anchor": {"choices": [0, 1]},
        "num_envs": {"low": 4, "high": 8},
    },
    "trials": 2,
    "sampler": "random",
    "pruner": "none",
}


def tiny(**changes):
    return config.from_mapping(sweep.SweepConfig, {**SWEEP, **changes}, "tiny")


def finished(folder, **changes):
    return run_jobs(sweep.plan_trials(tiny(**changes), folder), build_engine("local"))


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sweep")
    return folder, finished(folder)


def test_the_first_trial_is_the_recipe_and_the_best_one_becomes_a_recipe(whole):
    folder, results = whole
    own = sweep.settings_of(tiny(), {})
    assert results[0]["values"]["learner.learning_rate"] == own.learner.learning_rate
    assert results[0]["values"]["learner.anchor"] == 0  # the recipe has 0.0
    assert {result["state"] for result in results} == {"complete"}
    assert len({result["values"]["learner.learning_rate"] for result in results}) == 2
    best = sweep.write_best(folder, results)
    assert best["score"] == max(result["score"] for result in results)
    recipe = config.load(TrainConfig, folder / sweep.BEST)
    assert recipe.learner.batch_size == best["values"]["learner.batch_size"]
    assert recipe.num_envs == best["values"]["num_envs"]


def test_a_fraction_of_the_recipe_is_not_in_a_range_of_integers(tmp_path):
    ends = {"low": 0, "high": 1}  # the recipe has an entropy coefficient of 0.01
    sweep.plan_trials(tiny(space={"learner.ent_coef": ends, "learner.anchor": ends}), tmp_path)
    first = sweep.open_study(tmp_path).trials[0]
    assert first.system_attrs["fixed_params"] == {"learner.anchor": 0}


@pytest.mark.parametrize(
    ("owner", "name"),
    [(training._Run, "_step"), (optuna.Study, "tell"), (optuna.Trial, "suggest_categorical")],
)
def test_a_killed_sweep_continues_to_the_same_results(whole, tmp_path, monkeypatch, owner, name):
    with monkeypatch.context() as patch, pytest.raises(KilledError):
        stop_at(patch, owner, name, 2)
        finished(tmp_path)
    results = finished(tmp_path)
    assert [{**result, "policy": None} for result in results] == [
        {**result, "policy": None} for result in whole[1]
    ]


def test_a_sweep_can_be_extended_but_not_changed(tmp_path):
    first = finished(tmp_path, trials=1)
    assert finished(tmp_path, trials=2)[:1] == first
    with pytest.raises(KinfeasError, match="other settings"):
        sweep.plan_trials(tiny(seed=5), tmp_path)


def test_a_sweep_of_an_edited_recipe_is_an_error(tmp_path):
    file, out = tmp_path / "own.yaml", tmp_path / "out"
    own = tiny(recipe=str(file))
    file.write_text("robot: hsr\nlearner: {gamma: 0.9}\n")
    for _ in range(2):
        assert len(sweep.plan_trials(own, out)) == 2
    file.write_text("robot: hsr\nlearner: {gamma: 0.8}\n")
    with pytest.raises(KinfeasError, match="another recipe"):
        sweep.plan_trials(own, out)


@pytest.mark.parametrize("line", ["{", "7", '{"op_code": 99}', '{"op_code": 4}'])
def test_a_broken_journal_is_an_error_that_names_it(tmp_path, line):
    sweep.plan_trials(tiny(), tmp_path)
    journal = tmp_path / "journal.log"
    first, *others = journal.read_text().splitlines(keepends=True)
    journal.write_text("".join([first, f"{line}\n", *others]))
    before = journal.read_bytes()
    with pytest.raises(KinfeasError, match=r"journal\.log"):
        sweep.plan_trials(tiny(), tmp_path)
    assert journal.read_bytes() == before


def test_bad_trials_are_pruned_and_diverging_ones_fail(tmp_path, monkeypatch):
    check = training.check_finite

    def diverged(finite, learner):
        check(finite, learner)
        if learner.batch_size == 32:
            raise DivergedError("diverged")

    monkeypatch.setattr(training, "LOG_SECONDS", 0.0)
    monkeypatch.setattr(training, "check_finite", diverged)
    monkeypatch.setattr(optuna.Trial, "should_prune", lambda trial: trial.number == 2)
    space = {"learner.batch_size": {"choices": [16, 32]}}
    settings = SWEEP["settings"] | {"schedule.evaluations": 2}
    results = finished(tmp_path, trials=4, space=space, settings=settings)
    states = [(result["state"], result["values"]["learner.batch_size"]) for result in results]
    assert states[0] == ("complete", 16)
    assert states[2] in {("pruned", 16), ("fail", 32)}
    assert {state for state, _ in states} == {"complete", "pruned", "fail"}


@pytest.mark.parametrize(("space", "named"), [
    ({}, "space"), ({"learner.speed": {"choices": [1]}}, "learner.speed"),
    ({"num_envs": {"low": 1, "high": -1}}, "low"),
    ({"num_envs": {"choices": [0, 4]}}, "num_envs"),
    ({"num_envs": {"choices": [4], "when": {"seed": 1}}}, "seed"),
    ({"seed": {"choices": [1]}, "num_envs": {"choices": [4], "when": {"seed": 2}}}, "envs.when"),
])  # fmt: skip
def test_the_wrong_key_or_value_is_named(tmp_path, space, named):
    (tmp_path / "wrong.yaml").write_text(json.dumps({"space": space}))
    with pytest.raises(KinfeasError, match=named):
        sweep.read_sweep(str(tmp_path / "wrong.yaml"))


@pytest.mark.parametrize("name", ["pr2", "paper"])
def test_shipped_sweeps_are_valid(name):
    read = sweep.read_sweep(f"sweep/{name}")
    assert replace(read, trials=1).space
    assert name != "paper" or read.space["world.max_failures"].choices == (1, 19, 99)
