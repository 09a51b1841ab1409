import csv
import json
import os
import shutil
import signal
import threading
from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest
from safetensors.numpy import load_file

from kinfeas import __version__, config
from kinfeas.backends.analytic import AnalyticBackend
from kinfeas.config import registry
from kinfeas.core.errors import KinfeasError
from kinfeas.core.files import locked
from kinfeas.envs.episodes import evaluate_episodes
from kinfeas.io.policy_metadata import read_trained
from kinfeas.training import learner as learners
from kinfeas.training import logs, vec_env, worlds
from kinfeas.training import train as training
from kinfeas.training.config import TrainConfig
from kinfeas.training.run import finished
from kinfeas.training.train import resume, train
from tests.builders import KilledError, contents, kill, stop_at


@pytest.fixture
def half(whole, tmp_path):
    out = tmp_path / "half"
    shutil.copytree(whole, out)
    text = (out / "config.yaml").read_text()
    (out / "config.yaml").write_text(text.replace("steps: 320", "steps: 480"))
    return out


def state(out):
    return json.loads((out / "checkpoints" / "last" / "state.json").read_text())


def rows(out):
    with (out / "metrics.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def weights(out, name="last"):
    return load_file(out / "checkpoints" / name / "policy.safetensors")


def evaluated(out):
    """Return the evaluations in the metrics; losses are those of the step before, if any."""
    names = ["steps", "train/success", *(name for name in logs.COLUMNS if name[:4] == "eval")]
    return [[row[name] for name in names] for row in rows(out) if row["evaluation/success"]]


def assert_same(one, other):
    """Check that two runs are the same to the bit, apart from the clock."""
    for name in ("last/state.safetensors", "last/policy.safetensors", "best/policy.safetensors"):
        mine, others = (load_file(out / "checkpoints" / name) for out in (one, other))
        assert mine.keys() == others.keys()
        for key, values in mine.items():
            np.testing.assert_array_equal(values, others[key], err_msg=f"{name}: {key}")
    mine, others = state(one), state(other)
    for about in (mine, others):
        del about["progress"]["seconds"]
    assert mine == others
    assert evaluated(one) == evaluated(other)
    steps = [float(row["steps"]) for row in rows(one)]
    assert steps == sorted(steps)


def interrupt():
    signal.raise_signal(signal.SIGINT)


def interrupt_and_kill():
    interrupt()
    kill()


STOPS = [  # the first one with a replay buffer that is full
    (vec_env.EpisodesVecEnv, "step_wait", 35, kill),
    (vec_env.EpisodesVecEnv, "step_wait", 35, interrupt_and_kill),
    (shutil, "copyfile", 1, kill),
    (training, "explore", 15, interrupt),
    (training, "write_network", 2, interrupt),
]


def test_a_signal_is_not_lost_where_its_block_raises():
    with pytest.raises(KeyboardInterrupt), training.uninterrupted():
        interrupt_and_kill()


@pytest.mark.parametrize("stop", STOPS)
def test_a_run_stopped_anywhere_resumes_to_the_same_bits(whole, tiny, tmp_path, monkeypatch, stop):
    out = tmp_path / "run"
    with monkeypatch.context() as patch, pytest.raises((KeyboardInterrupt, KilledError)):
        stop_at(patch, *stop)
        train(tiny(), out)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    resume(out)
    assert_same(out, whole)


def test_a_run_killed_between_best_and_last_evaluates_again(whole, tiny, tmp_path, monkeypatch):
    save = training.save_learner

    def stopped(folder, learner, snapshot, state):
        if state["progress"]["evaluations"] == 2:
            kill()
        save(folder, learner, snapshot, state)

    with monkeypatch.context() as patch, pytest.raises(KilledError):
        patch.setattr(training, "save_learner", stopped)
        train(tiny(), tmp_path / "run")
    resume(tmp_path / "run")
    assert_same(tmp_path / "run", whole)


def test_a_run_killed_before_its_first_checkpoint_begins_again(whole, tiny, tmp_path):
    config.dump(tiny(), tmp_path / "config.yaml")
    resume(tmp_path)
    assert_same(tmp_path, whole)


def test_a_finished_run_resumes_to_nothing_and_a_longer_one_goes_on(whole, half):
    before = contents(whole / "checkpoints")
    assert resume(whole).steps == 320
    assert contents(whole / "checkpoints") == before
    with (half / "metrics.csv").open("a") as file:
        file.write("330,7.0\n470,9.0\n")  # written after the last checkpoint
    (half / "evaluation.json").write_text("{}")  # of a best policy that is no longer there
    assert resume(half).steps == 480
    assert read_trained(half).steps == 480
    assert not (half / "evaluation.json").exists()
    assert [row[0] for row in evaluated(half)] == ["160", "320", "480"]
    assert not {"330", "470"} & {row["steps"] for row in rows(half)}


def test_divergence_raises_and_keeps_the_last_checkpoint(tiny, tmp_path, monkeypatch):
    learner = replace(tiny().learner, learning_rate=1e20)
    with pytest.raises(KinfeasError, match=r"learner\.learning_rate"):
        train(replace(tiny(), learner=learner), tmp_path / "fast")

    step, before, run = training._Run._step, {}, tmp_path / "run"

    def diverging(self):
        step(self)
        if self.progress.steps >= 200:
            before.update(before or contents(run / "checkpoints"))
            self.learner.logger.record("train/critic_loss", float("nan"))

    monkeypatch.setattr(training._Run, "_step", diverging)
    with pytest.raises(KinfeasError, match=r"learner\.learning_rate"):
        train(tiny(), run)
    assert before
    assert contents(run / "checkpoints") == before


@pytest.fixture
def ticks(monkeypatch):
    """A function that replaces the clock by one that calls of functions advance."""

    def advance(owner, name, seconds):
        function = getattr(owner, name)

        def ticking(*arguments, **options):
            advance.now += seconds
            return function(*arguments, **options)

        monkeypatch.setattr(owner, name, ticking)

    advance.now = 0.0
    monkeypatch.setattr(training.time, "monotonic", lambda: advance.now)
    return advance


def test_minutes_count_training_without_evaluations(tiny, tmp_path, ticks):
    ticks(training, "explore", 1.0)
    ticks(training, "summarize", 1000.0)
    reports = []
    settings = tiny({"schedule.steps": None, "schedule.minutes": 0.5})
    progress = train(settings, tmp_path / "run", reports.append)
    assert (progress.steps, progress.seconds, progress.fraction) == (240, 30.0, 1.0)
    assert progress.evaluations == 2
    assert [one.steps for one in reports if one.evaluating] == [120, 240, 240]
    longer = resume(tmp_path / "run", settings={"schedule.minutes": 0.6})
    assert (longer.steps, longer.seconds) == (288, 36.0)


@pytest.fixture
def engine(unregistered):
    """Register a backend that stands for an engine of physics."""
    registry.register("kinfeas.backends", "engine", AnalyticBackend)


@pytest.fixture
def timed(engine, tiny, monkeypatch, ticks):
    """Two minutes with physics, in which an action takes 1 s and a round of an evaluation 6 s."""

    def within(seconds, pool, processes, *parts):
        build, policy, episodes, on_done = parts
        rounds = max(1, int(seconds / 6.0))
        ticks.now += 6.0 * min(rounds, len(episodes) / 4)
        return evaluate_episodes(build, policy, episodes[: 4 * rounds], on_done=on_done)

    ticks(training, "explore", 1.0)
    monkeypatch.setattr(worlds, "evaluate_within", within)
    schedule = {"steps": None, "minutes": 2, "evaluations": 6, "evaluation_episodes": 32}
    schedule |= {"final_episodes": 256, "checkpoint_seconds": 30}
    return tiny({"world.backend": "engine", "schedule": schedule})


def test_minutes_with_physics_include_evaluations(timed, tmp_path, ticks):
    reports = []
    progress = train(timed, tmp_path / "run", reports.append)
    assert 100.0 < ticks.now <= 130.0
    assert progress.seconds > 60.0
    assert progress.seconds + progress.other_seconds == ticks.now
    assert progress.evaluations == 6
    assert (0, 32) in [one.evaluating for one in reports]
    figures = json.loads((tmp_path / "run/checkpoints/best/policy.json").read_text())
    assert figures["fresh_evaluation"]["episodes"] >= 4
    longer = resume(tmp_path / "run", settings={"schedule.minutes": 4})
    assert longer.evaluations == 6
    assert 220.0 < longer.seconds + longer.other_seconds <= 250.0


def test_a_resumed_run_goes_on_with_its_time_for_evaluations(timed, tmp_path, monkeypatch):
    whole, out = tmp_path / "whole", tmp_path / "run"
    train(timed, whole)
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        stop_at(patch, training, "explore", 40, interrupt)
        train(timed, out)
    resume(out)
    assert [row[0] for row in evaluated(out)] == [row[0] for row in evaluated(whole)]


@pytest.mark.usefixtures("engine")
def test_a_run_with_physics_begins_in_the_analytic_world(tiny, tmp_path, monkeypatch):
    world = {"world.backend": "engine", "world.dt": 0.02, "action_repeat": 5}
    settings = tiny({**world, "schedule.analytic": 0.5})
    explore = Mock(side_effect=training.explore)
    with monkeypatch.context() as patch:
        patch.setattr(training, "explore", explore)
        train(settings, tmp_path / "whole")
    assert explore.call_count == 24  # 8 episodes: 20 actions of one period, then 4 of 5 periods
    assert [row[0] for row in evaluated(tmp_path / "whole")] == ["160", "320"]
    with monkeypatch.context() as patch, pytest.raises(KilledError):
        stop_at(patch, training, "explore", 23)
        train(settings, tmp_path / "run")
    resume(tmp_path / "run")
    assert_same(tmp_path / "run", tmp_path / "whole")


def test_the_best_policy_is_kept_and_evaluated_afresh_once(tiny, tmp_path, monkeypatch):
    successes, original = iter([0.5, 0.25, 0.5, 0.4, 0.3]), training.summarize
    evaluator = Mock(side_effect=training.evaluate_network)

    def scored(records):
        success = next(successes)
        return {**original(records), "success": success, "tracked_5cm": success}

    monkeypatch.setattr(training, "summarize", scored)
    monkeypatch.setattr(training, "evaluate_network", evaluator)
    out = tmp_path / "run"
    train(tiny({"schedule.evaluations": 4}), out)
    about = json.loads((out / "checkpoints/best/policy.json").read_text())
    assert about["evaluation"]["success"] == 0.5
    assert about["fresh_evaluation"]["success"] == 0.3
    assert about["steps"] == 240  # of equals the later one
    assert about["config"]["robot"] == "hsr"
    seeds = [call.args[3] for call in evaluator.call_args_list]
    assert seeds == [worlds.EVALUATION_SEED] * 4 + [worlds.FRESH_SEED]
    resume(out)
    assert evaluator.call_count == len(seeds)
    assert finished(out)


@pytest.mark.parametrize("settings", [
    {"task": "dance"}, {"world.adapters": ["fog"]}, {"init": "follow_ee"}, {"trackers": ["wandb"]},
])  # fmt: skip
def test_a_wrong_configuration_raises_before_anything_is_written(
    tiny, tmp_path, monkeypatch, settings
):
    monkeypatch.setattr("kinfeas.core.extras.find_spec", lambda name: None)  # no wandb
    with pytest.raises(KinfeasError):
        train(tiny(settings), tmp_path / "run")
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("file", ["state.json", "state.safetensors", "policy.safetensors"])
def test_a_broken_checkpoint_raises_and_stays(half, file):
    path, threads = half / "checkpoints" / "last" / file, threading.active_count()
    content = path.read_bytes()
    path.unlink()
    with pytest.raises(KinfeasError, match="last"):
        resume(half)
    os.mkfifo(path)
    with pytest.raises(KinfeasError, match=rf"last/{file}: .*regular file"):
        resume(half)
    path.unlink()
    if file != "state.json":
        damaged = bytearray(content)
        damaged[len(content) // 2] ^= 1
        path.write_bytes(damaged)
        with pytest.raises(KinfeasError, match=rf"last/{file}: is damaged"):
            resume(half)
    path.write_bytes(content[: int(0.99 * len(content))])
    before = contents(half)
    with pytest.raises(KinfeasError, match="last"):
        resume(half)
    assert contents(half) == before
    assert threading.active_count() == threads  # environments have ended


def test_a_folder_in_use_raises(half, tiny, tmp_path):
    before = contents(half)
    with locked(half), pytest.raises(KinfeasError, match="half"):
        resume(half)
    assert contents(half) == before
    (tmp_path / "empty").mkdir()
    with locked(tmp_path / "empty"), pytest.raises(KinfeasError, match="empty"):
        train(tiny(), tmp_path / "empty")
    assert not list((tmp_path / "empty").iterdir())


def test_a_full_disk_raises_and_loses_nothing(half, monkeypatch):
    before = contents(half / "checkpoints" / "last")
    with monkeypatch.context() as patch, pytest.raises(KinfeasError, match=r"last: .*No space"):
        patch.setattr(learners, "save_file", Mock(side_effect=OSError(28, "No space left")))
        resume(half)
    assert contents(half / "checkpoints" / "last") == before


def test_an_initial_policy_sets_the_layers_and_waits_for_the_critics(
    whole, tiny, tmp_path, monkeypatch
):
    monkeypatch.chdir(whole.parent)
    out = tmp_path / "run"
    settings = tiny({"init": whole.name, "learner.net_arch": [8], "learner.critic_steps": 9999})
    assert train(settings, out).evaluations == 3
    tuned = config.load(TrainConfig, out / "config.yaml")
    assert tuned.learner.net_arch == (16, 16)
    assert tuned.init == str(whole)
    for name, values in weights(whole, "best").items():
        np.testing.assert_array_equal(weights(out)[name], values)
    assert any(row["train/critic_loss"] for row in rows(out))
    # A policy that has not changed is evaluated once.
    assert [row[0] for row in evaluated(out)] == ["0"]


def test_a_resumed_run_does_not_need_its_initial_policy(whole, tiny, tmp_path, monkeypatch):
    first, through, out = (tmp_path / name for name in ("first", "through", "run"))
    shutil.copytree(whole, first)
    settings = tiny({"init": first, "learner.anchor": 1.0})
    train(settings, through)
    with monkeypatch.context() as patch, pytest.raises(KilledError):
        stop_at(patch, *STOPS[0])
        train(settings, out)
    shutil.rmtree(first)
    resume(out)
    assert_same(out, through)


@pytest.mark.slow
def test_wandb_has_recipe_and_figures_offline(tiny, tmp_path, monkeypatch):
    wandb = pytest.importorskip("wandb")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("WANDB_MODE", "offline")
    monkeypatch.setenv("WANDB_SILENT", "true")
    seen, log = [], wandb.Run.log
    monkeypatch.setattr(
        wandb.Run, "log", lambda run, data, **o: (seen.append((run, data)), log(run, data, **o))
    )
    train(tiny({"trackers": ["wandb"], "schedule.steps": 160}), tmp_path / "run")
    resume(tmp_path / "run", settings={"schedule.steps": 320})  # in the same run of the tracker
    assert len(list((tmp_path / "run" / "wandb").glob("offline-run-*/*.wandb"))) == 2
    assert len({run.id for run, _ in seen}) == 1
    run, _ = seen[0]
    assert run.config["version"] == __version__
    assert run.config["learner"]["net_arch"]
    assert "fresh/success" in seen[-1][1]


def test_tensorboard_has_version_recipe_and_figures(tiny, tmp_path):
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    train(tiny({"trackers": ["tensorboard"], "schedule.steps": 160}), tmp_path / "run")
    events = EventAccumulator(str(tmp_path / "run" / "tensorboard")).Reload()
    assert "fresh/success" in events.Tags()["scalars"]
    assert {"version/text_summary", "recipe/text_summary"} <= set(events.Tags()["tensors"])
