import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
from safetensors.numpy import load_file, save_file

from kinfeas import config
from kinfeas.core.errors import KinfeasError
from kinfeas.io.folders import alone
from kinfeas.policies.network import read_network
from kinfeas.robots.loading import load_robot
from kinfeas.training import checkpoint, logs, worlds
from kinfeas.training import train as training
from kinfeas.training.config import TrainConfig
from kinfeas.training.learner import network_of
from kinfeas.training.run_status import finished as finished_run
from kinfeas.training.train import resume, train

LEARNERS = {
    "sac": (),
    "sac with learned entropy": ("learner.ent_coef=learned",),
    "td3": ("learner.algorithm=td3", "learner.schedule=constant"),
}

# Slowed down, so that it cannot end before it is killed; no figure depends on it.
TRAIN = """
import sys, time
from pathlib import Path
from kinfeas import config
from kinfeas.training.config import TrainConfig
from kinfeas.training.learner import network_of
from kinfeas.training.train import _Run, train
step = _Run._step
_Run._step = lambda run: (time.sleep(0.02), step(run))
train(config.load(TrainConfig, Path(sys.argv[1])), Path(sys.argv[2]))
"""


@pytest.fixture(scope="module", params=LEARNERS.values(), ids=LEARNERS.keys())
def whole(request, tiny, tmp_path_factory):
    """Return the settings of a run, and the run that nothing interrupted."""
    settings = tiny(*request.param)
    out = tmp_path_factory.mktemp("whole") / "run"
    train(settings, out)
    return settings, out


@pytest.fixture(scope="module")
def plain(tiny, tmp_path_factory):
    """Return the same for the first learner alone."""
    out = tmp_path_factory.mktemp("plain") / "run"
    train(tiny(), out)
    return tiny(), out


@pytest.fixture(scope="module")
def finished(tiny, tmp_path_factory):
    """Return a finished run that tests do not change."""
    out = tmp_path_factory.mktemp("finished") / "run"
    train(tiny("schedule.steps=800"), out)
    return out


@pytest.fixture
def half(finished, tmp_path):
    """Return a copy of it that has more to do."""
    out = tmp_path / "half"
    subprocess.run(["cp", "-r", finished, out], check=True)
    text = (out / "config.yaml").read_text()
    assert "steps: 800" in text
    (out / "config.yaml").write_text(text.replace("steps: 800", "steps: 1600"))
    return out


def state(out):
    return json.loads((out / "checkpoints" / "last" / "state.json").read_text())


def rows(out):
    with (out / "metrics.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def assert_same(one, other):
    """Check that two runs came to the same, to the bit, the clock apart."""
    for name in ("last/state.safetensors", "last/policy.safetensors", "best/policy.safetensors"):
        mine, others = (load_file(out / "checkpoints" / name) for out in (one, other))
        assert mine.keys() == others.keys()
        for key, values in mine.items():
            np.testing.assert_array_equal(values, others[key], err_msg=f"{name}: {key}")
    mine, others = state(one), state(other)
    for about in (mine, others):
        del about["progress"]["seconds"]
    assert repr(mine) == repr(others)  # NaN is not equal to itself
    assert judgements(one) == judgements(other)


def judgements(out):
    """Return the rows with an evaluation; losses are of the last step before, which may be none."""
    names = [name for name in logs.COLUMNS if name.startswith("evaluation/")]
    judged = [row for row in rows(out) if row["evaluation/success"]]
    return [[row[name] for name in ("steps", "train/success", *names)] for row in judged]


def assert_monotone(out):
    steps = [float(row["steps"]) for row in rows(out)]
    assert steps == sorted(steps)


def test_a_run_leaves_what_it_should(whole):
    settings, out = whole
    assert config.load(type(settings), out / "config.yaml") == settings
    assert {path.name for path in (out / "checkpoints").iterdir()} == {"best", "last"}
    assert list((out / "tensorboard").glob("events.*"))
    judged = [row for row in rows(out) if row["evaluation/success"]]
    assert [int(row["steps"]) for row in judged] == [800, 1600]
    assert_monotone(out)
    assert state(out)["progress"]["steps"] == 1600
    network = read_network(out, load_robot("pr2"))
    assert [len(bias) for bias in network.biases] == [16, 16, 3]


@contextmanager
def child_that_trains(settings, folder, out):
    """Yield a process once it has learned something and written a checkpoint of it."""
    config.dump(settings, folder / "settings.yaml")
    errors = folder / "stderr"
    with errors.open("w") as file:
        child = subprocess.Popen(
            [sys.executable, "-c", TRAIN, folder / "settings.yaml", out], stderr=file
        )
    try:
        deadline = time.monotonic() + 120.0
        while checkpoint_steps(out) <= settings.learner.learning_starts:
            assert child.poll() is None, errors.read_text()
            assert time.monotonic() < deadline
            time.sleep(0.005)
        yield child
    finally:
        child.kill()
        child.wait()


def test_a_run_killed_and_resumed_equals_an_uninterrupted_one(whole, tmp_path):
    settings, expected = whole
    out = tmp_path / "run"
    with child_that_trains(settings, tmp_path, out) as child:
        child.send_signal(signal.SIGKILL)
        assert child.wait() == -signal.SIGKILL
    assert 200 < checkpoint_steps(out) < 1600
    resume(out)
    assert_same(out, expected)
    assert_monotone(out)


def checkpoint_steps(out):
    try:
        return state(out)["progress"]["steps"]
    except (FileNotFoundError, json.JSONDecodeError):
        return 0


def test_a_run_resumed_without_a_checkpoint_begins_again(plain, tmp_path):
    settings, expected = plain
    config.dump(settings, tmp_path / "config.yaml")
    resume(tmp_path)
    assert_same(tmp_path, expected)


def test_a_run_that_lost_its_checkpoint_does_not_begin_again(half, digest):
    shutil.rmtree(half / "checkpoints" / "last")
    before = digest(half)
    with pytest.raises(KinfeasError, match="last: missing, and there is no other checkpoint"):
        resume(half)
    assert digest(half) == before


class KilledError(BaseException):
    """What nobody catches, as nobody catches a kill."""


def test_a_run_killed_after_its_first_evaluation_resumes(plain, tmp_path, monkeypatch):
    settings, expected = plain
    seldom = replace(settings.schedule, checkpoint_seconds=1000.0)
    write, out = training._Run._write, tmp_path / "run"

    def killed(run, name, fill):
        write(run, name, fill)
        if name == "best":
            raise KilledError

    with monkeypatch.context() as patch, pytest.raises(KilledError):
        patch.setattr(training._Run, "_write", killed)
        train(replace(settings, schedule=seldom), out)
    assert (out / "checkpoints" / "best").is_dir()
    resume(out)
    assert_same(out, expected)


def test_a_run_killed_over_its_first_file_begins_again(tiny, tmp_path, monkeypatch):
    out = tmp_path / "run"
    (out / ".half").mkdir(parents=True)
    assert train(tiny("schedule.steps=80"), out).steps == 80


def test_learning_that_diverges_is_a_clear_error(tiny, tmp_path):
    settings = tiny()
    learner = replace(settings.learner, learning_rate=1e20)
    with pytest.raises(KinfeasError, match="learning diverged: learner"):
        train(replace(settings, learner=learner), tmp_path / "run")


def test_a_loss_that_is_no_number_keeps_the_last_checkpoint(tiny, tmp_path, monkeypatch, digest):
    settings, run = tiny("schedule.steps=4000", "schedule.evaluations=4"), tmp_path / "run"
    step, before = training._Run._step, {}

    def diverging(self):
        step(self)
        if self.progress.steps >= 2000:
            before.update(before or digest(run / "checkpoints"))
            self.learner.logger.record("train/critic_loss", float("nan"))

    monkeypatch.setattr(training._Run, "_step", diverging)
    with pytest.raises(KinfeasError, match="learning diverged: learner"):
        train(settings, run)
    assert before
    assert digest(run / "checkpoints") == before


def interrupt_at(monkeypatch, owner, name, call):
    """Let Ctrl-C be pressed within the n-th call of a function."""
    function, calls = getattr(owner, name), []

    def interrupted(*arguments, **options):
        calls.append(1)
        if len(calls) == call:
            signal.raise_signal(signal.SIGINT)
        return function(*arguments, **options)

    monkeypatch.setattr(owner, name, interrupted)


@pytest.mark.parametrize(
    ("owner", "name", "call"),
    [
        (worlds.World, "step", 40),  # in the midst of a step
        (training, "explore", 100),
        (worlds, "run_episodes", 1),  # while it is judged
        (worlds, "run_episodes", 2),  # for the last time
        (training, "write_network", 2),  # while a checkpoint is written
        (training._Run, "_row", 1),
    ],
)
def test_ctrl_c_leaves_a_checkpoint_that_resumes(plain, tmp_path, monkeypatch, owner, name, call):
    settings, expected = plain
    out = tmp_path / "run"
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        interrupt_at(patch, owner, name, call)
        train(settings, out)
    assert checkpoint_steps(out) > 0
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    resume(out)
    assert_same(out, expected)
    assert_monotone(out)


def test_ctrl_c_from_outside(plain, tmp_path):
    settings, expected = plain
    out = tmp_path / "run"
    with child_that_trains(settings, tmp_path, out) as child:
        child.send_signal(signal.SIGINT)
        assert child.wait(timeout=60) != 0
    resume(out)
    assert_same(out, expected)


def test_rows_beyond_the_checkpoint_are_dropped(half):
    with (half / "metrics.csv").open("a") as file:
        file.write("900,7.0\n1500,9.0\n")
    resume(half)
    steps = [int(row["steps"]) for row in rows(half)]
    assert 900 not in steps
    assert 1500 not in steps
    assert steps[-1] == 1600
    assert_monotone(half)


def test_a_finished_run_resumes_to_nothing(finished, digest):
    before = digest(finished / "checkpoints")
    progress = resume(finished)
    assert (progress.steps, progress.share) == (800, 1.0)
    assert digest(finished / "checkpoints") == before


def test_a_longer_schedule_takes_a_finished_run_further(half):
    assert resume(half).steps == 1600
    assert sum(bool(row["evaluation/success"]) for row in rows(half)) == 3


def test_minutes_end_a_run_and_count_over_its_parts(tiny, tmp_path):
    settings = tiny("schedule.steps=null", "schedule.minutes=0.02", "num_envs=4")
    seen = []
    progress = train(settings, tmp_path / "run", seen.append)
    assert progress.share == 1.0
    assert progress.seconds >= 1.2
    assert progress.evaluations == 2
    assert seen
    assert resume(tmp_path / "run").steps == progress.steps


def test_evaluations_take_no_time_of_training(tiny, tmp_path, monkeypatch):
    run_episodes, clock, real = worlds.run_episodes, {"now": 0.0}, time.monotonic

    def slow(*arguments):
        clock["now"] += 1000.0
        return run_episodes(*arguments)

    monkeypatch.setattr(worlds, "run_episodes", slow)
    monkeypatch.setattr(time, "monotonic", lambda: real() + clock["now"])
    seen = []
    progress = train(tiny("schedule.steps=80"), tmp_path / "run", seen.append)
    assert progress.evaluations == 2
    assert progress.seconds < 1000.0
    assert [one.steps for one in seen if one.evaluating] == [40, 80]


def test_the_best_policy_is_kept(tiny, tmp_path, monkeypatch):
    successes = iter([0.5, 0.25, 0.5, 0.4, 0.3])
    original = training.summarize

    def scored(records):
        success = next(successes)
        return {**original(records), "success": success, "within_5cm": success}

    monkeypatch.setattr(training, "summarize", scored)
    train(tiny("schedule.evaluations=4", "schedule.steps=800"), tmp_path / "run")
    about = json.loads((tmp_path / "run/checkpoints/best/policy.json").read_text())
    assert about["evaluation"]["success"] == 0.5
    assert about["fresh_evaluation"]["success"] == 0.3
    assert about["steps"] == 600  # of equals the later one
    assert about["config"]["robot"] == "pr2"


def test_the_best_policy_is_judged_afresh_once(tiny, tmp_path, monkeypatch, digest):
    out, offsets, original = tmp_path / "run", [], training.analytic_judge

    def judge(config, network, offset):
        offsets.append(offset)
        if len(offsets) == 2:
            raise KeyboardInterrupt
        return original(config, network, offset)

    monkeypatch.setattr(training, "analytic_judge", judge)
    with pytest.raises(KeyboardInterrupt):
        train(tiny("schedule.steps=160", "schedule.evaluations=1"), out)
    assert finished_run(out) is None
    steps = resume(out).steps
    assert offsets == [worlds.EVALUATION_SEED, worlds.FRESH_SEED] * 2
    assert finished_run(out).steps == steps
    best = digest(out / "checkpoints/best")
    resume(out)
    assert worlds.FRESH_SEED not in offsets[4:]
    assert digest(out / "checkpoints/best") == best


def test_a_folder_with_something_in_it_is_not_written_over(finished, tiny, digest):
    before = digest(finished)
    with pytest.raises(KinfeasError, match=r"already there; use --resume .*, or another --out"):
        train(tiny(), finished)
    assert digest(finished) == before


def test_resuming_is_suggested_for_a_run_only(tiny, tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(KinfeasError, match="holds other files, --out needs a new or an empty fold"):
        train(tiny(), tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


def test_an_empty_folder_is_welcome(tiny, tmp_path):
    out = tmp_path / "run"
    out.mkdir()
    assert train(tiny("schedule.steps=80"), out).steps == 80


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("robot=pr3", "unknown robot 'pr3'"),
        ("task=dance", "unknown task 'dance'"),
        ("task_parameters={speed: 3}", "speed"),
        ("world.adapters=[{name: fog}]", "unknown adapter 'fog'"),
    ],
)
def test_nothing_is_written_for_a_wrong_configuration(tiny, tmp_path, override, message):
    with pytest.raises(KinfeasError, match=message):
        train(tiny(override), tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_a_folder_that_cannot_be_made_is_a_clear_error(tiny, tmp_path):
    (tmp_path / "file").write_text("mine")
    for out in (tmp_path / "file", tmp_path / "file" / "run"):
        with pytest.raises(KinfeasError, match=r"file.*: cannot be written: "):
            train(tiny(), out)
    assert (tmp_path / "file").read_text() == "mine"


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_read_only_folder_is_a_clear_error(half, tiny, tmp_path):
    out = tmp_path / "closed"
    out.mkdir(mode=0o500)
    with pytest.raises(KinfeasError, match=r"closed.*: cannot be written: Permission denied"):
        train(tiny(), out / "run")
    half.chmod(0o500)
    with pytest.raises(KinfeasError, match=r"half.*: cannot be written: Permission denied"):
        resume(half)
    half.chmod(0o700)


def test_metrics_that_cannot_be_written_are_a_clear_error(half, digest):
    (half / "metrics.csv").unlink()
    (half / "metrics.csv").mkdir()
    before = digest(half)
    with pytest.raises(KinfeasError, match=r"metrics\.csv: cannot be written: Is a directory"):
        resume(half)
    assert digest(half) == before


def test_metrics_of_something_else_are_a_clear_error(half, digest):
    (half / "metrics.csv").write_text("a,b\n1,2\n")
    before = digest(half)
    with pytest.raises(KinfeasError, match="not the metrics of a training run"):
        resume(half)
    assert digest(half) == before


def test_a_full_disk_is_a_clear_error_and_loses_nothing(half, monkeypatch, digest):
    def full(*_):
        raise OSError(28, "No space left on device")

    before = digest(half / "checkpoints")
    with monkeypatch.context() as patch:
        patch.setattr(checkpoint, "save_file", full)
        with pytest.raises(KinfeasError, match=r"last: cannot be written: No space left on device"):
            resume(half)
    after = digest(half / "checkpoints")
    assert {key: after[key] for key in before if key.startswith("last/")} == {
        key: value for key, value in before.items() if key.startswith("last/")
    }
    assert resume(half).steps == 1600


def test_a_full_disk_is_a_clear_error_of_the_logs_as_well(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    with (
        pytest.raises(KinfeasError, match=r"tensorboard: cannot be written: No space left"),
        logs.Logs(tmp_path, 0) as written,
    ):
        monkeypatch.setattr(written._board, "add_scalar", full)
        written.write({"steps": 1.0, "seconds": 1.0})
    with (
        pytest.raises(KinfeasError, match=r"tensorboard: cannot be written: No space left"),
        logs.Logs(tmp_path, 0) as written,
    ):
        monkeypatch.setattr(written._board, "close", full)


def test_a_run_that_goes_on_is_not_disturbed(half, tiny, tmp_path, digest):
    before = digest(half)
    with alone(half), pytest.raises(KinfeasError, match="another process is at work in it"):
        resume(half)
    assert digest(half) == before
    out = tmp_path / "empty"
    out.mkdir()
    with alone(out), pytest.raises(KinfeasError, match="another process is at work in it"):
        train(tiny(), out)
    assert not list(out.iterdir())


@pytest.mark.parametrize("name", ["nothing", "."])
def test_a_folder_that_is_no_run_is_a_clear_error(tmp_path, name):
    with pytest.raises(KinfeasError, match=r"not a training run: there is no config\.yaml in it"):
        resume(tmp_path / name)


@pytest.mark.parametrize(
    ("old", "new", "key"),
    [
        ("robot: pr2", "robot: hsr", "robot"),
        ("num_envs: 8", "num_envs: 4", "num_envs"),
        ("algorithm: sac", "algorithm: td3", "learner"),
        ("name: base_noise", "name: base_noise\n    parameters: {linear: 0.1}", "world"),
    ],
)
def test_a_checkpoint_of_another_run_is_a_clear_error(half, digest, old, new, key):
    path = half / "config.yaml"
    text = path.read_text().replace("\n    parameters: {}", "")
    assert old in text
    path.write_text(text.replace(old, new))
    before = digest(half)
    with pytest.raises(KinfeasError, match=f"a checkpoint of another run: its {key} is"):
        resume(half)
    assert digest(half) == before


@pytest.mark.parametrize("name", ["state.json", "state.safetensors"])
@pytest.mark.parametrize("share", [None, 0.0, 0.3, 0.99])
def test_a_broken_checkpoint_is_a_clear_error(half, digest, name, share):
    path = half / "checkpoints" / "last" / name
    content = path.read_bytes()
    path.unlink()
    if share is not None:
        path.write_bytes(content[: int(share * len(content))])
    before = digest(half)
    with pytest.raises(KinfeasError, match=r"last: (broken checkpoint|no checkpoint to resume)"):
        resume(half)
    assert digest(half) == before


@pytest.mark.parametrize(
    "content", ["[]", "{}", "3", '{"format": 2}', '{"format": 1}', "\0", "[" * 100_000]
)
def test_a_foreign_checkpoint_is_a_clear_error(half, content):
    (half / "checkpoints" / "last" / "state.json").write_text(content)
    with pytest.raises(KinfeasError, match="last: broken checkpoint, or one of another run"):
        resume(half)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("steps", float("inf")), ("steps", "many"), ("steps", -8), ("steps", 1.5),
        ("seconds", float("nan")), ("seconds", -1.0), ("seconds", None),
        ("best", "a"), ("best", float("inf")), ("best", 2.0), ("best", None),
        ("evaluations", "a"), ("evaluations", float("inf")), ("evaluations", -1),
        ("recent", 3), ("recent", [0.5]), ("recent", "ab"), ("recent", None), ("more", 1),
    ],
)  # fmt: skip
def test_a_broken_progress_is_a_clear_error(half, digest, key, value):
    path = half / "checkpoints" / "last" / "state.json"
    about = json.loads(path.read_text())
    path.write_text(json.dumps({**about, "progress": {**about["progress"], key: value}}))
    before = digest(half)
    with pytest.raises(
        KinfeasError, match=f"last: broken checkpoint, .* state.json: .*'{key}[.0]*'"
    ):
        resume(half)
    assert digest(half) == before


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("policy.actor.mu.weight", np.nan, "policy.actor.mu.weight holds numbers that are not fin"),
        ("policy.critic.qf0.0.bias", np.inf, "policy.critic.qf0.0.bias holds numbers that are not"),
        ("buffer.rewards", np.nan, "buffer.rewards holds numbers that are not finite"),
        ("world.desired", np.nan, "world.desired holds numbers that are not finite"),
        ("world.next_episode", -5, "a snapshot whose next episode is -5"),
    ],
)
def test_senseless_numbers_are_a_clear_error(half, digest, key, value, message):
    path = half / "checkpoints" / "last" / "state.safetensors"
    tensors = load_file(path)
    tensors[key] = np.full_like(tensors[key], value)
    save_file(tensors, path)
    before = digest(half)
    with pytest.raises(KinfeasError, match=f"last: broken checkpoint, .*{message}"):
        resume(half)
    assert digest(half) == before


def test_a_robot_that_was_changed_since_is_a_clear_error(tiny, tmp_path, digest):
    shipped, mine, out = load_robot("pr2"), tmp_path / "mine.yaml", tmp_path / "run"
    text = (shipped.urdf_path.with_name("pr2.yaml")).read_text()
    mine.write_text(text.replace("urdf: pr2.urdf", f"urdf: {shipped.urdf_path}"))
    train(tiny(f"robot={mine}", "schedule.steps=80"), out)
    assert "max_velocity: 0.2" in text
    mine.write_text(mine.read_text().replace("max_velocity: 0.2", "max_velocity: 0.3"))
    before = digest(out)
    with pytest.raises(KinfeasError, match=f"^{out}/checkpoints/last: the kinematics of robot"):
        resume(out)
    assert digest(out) == before


@pytest.mark.parametrize("progress", [None, [], {}, "far"])
def test_no_progress_is_a_clear_error(half, progress):
    path = half / "checkpoints" / "last" / "state.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "progress": progress}))
    with pytest.raises(KinfeasError, match="last: broken checkpoint, or one of another run"):
        resume(half)


def test_the_state_of_a_writer_killed_between_its_renames_is_found(half):
    checkpoints = half / "checkpoints"
    for name in ("last", "best"):
        (checkpoints / name).rename(checkpoints / f".{name}.old")
    assert read_network(half, load_robot("pr2")).biases
    assert resume(half).steps == 1600
    assert {path.name for path in checkpoints.iterdir()} >= {"last"}


def test_metrics_are_replaced_not_overwritten(half, monkeypatch):
    before = (half / "metrics.csv").read_bytes()

    def killed(*_):
        raise KilledError

    with monkeypatch.context() as patch, pytest.raises(KilledError):
        patch.setattr(logs.csv.DictWriter, "writerows", killed)
        resume(half)
    assert (half / "metrics.csv").read_bytes() == before


def weights(out, name="last"):
    return load_file(out / "checkpoints" / name / "policy.safetensors")


def test_a_run_goes_on_from_a_policy_whose_shape_it_takes(finished, tiny, tmp_path):
    # The critics learn all the time, the actor never does.
    settings = tiny(f"init={finished}", "learner.net_arch=[8]", "learner.critic_steps=9999")
    out = tmp_path / "run"
    assert train(settings, out).evaluations == 3
    tuned = config.load(TrainConfig, out / "config.yaml")
    assert tuned.learner.net_arch == (16, 16)
    for name, values in weights(finished, "best").items():
        np.testing.assert_array_equal(weights(out)[name], values)
    critics = [row["train/critic_loss"] for row in rows(out) if row["train/critic_loss"]]
    assert critics
    # The policy that never changed is evaluated once.
    judged = [row for row in rows(out) if row["evaluation/success"]]
    assert [row["steps"] for row in judged] == ["0"]


def test_without_a_policy_to_go_on_from_the_actor_learns_at_once(tiny, tmp_path):
    settings = tiny(
        "learner.critic_steps=9999", "schedule.steps=400", "learner.learning_starts=100"
    )
    train(settings, tmp_path / "run")
    run = training._Run(settings, tmp_path / "no")
    run.env.close()
    fresh = network_of(run.learner, run.env.scale)
    assert not np.array_equal(weights(tmp_path / "run")["weight.0"], fresh.weights[0])


def test_the_actor_learns_after_the_critics(finished, tiny, tmp_path):
    out = tmp_path / "run"
    train(tiny(f"init={finished}", "learner.critic_steps=200"), out)
    assert not np.array_equal(weights(out)["weight.0"], weights(finished, "best")["weight.0"])


def test_what_it_goes_on_from_may_be_named_from_any_folder(finished, tiny, tmp_path, monkeypatch):
    monkeypatch.chdir(finished.parent)
    out = tmp_path / "run"
    train(tiny(f"init={finished.name}"), out)
    monkeypatch.chdir(tmp_path)
    assert config.load(TrainConfig, out / "config.yaml").init == str(finished)
    assert resume(out).evaluations == 3


@pytest.mark.parametrize(
    ("init", "message"),
    [
        ("follow_ee", "init: follow_ee: neither the folder of a training run or of a checkpoint"),
        ("nowhere", "init: nowhere: neither .* nor 'pretrained'; nothing else has weights"),
        ("''", "init: '': neither the folder"),
    ],
)
def test_what_has_no_weights_is_a_clear_error(tiny, tmp_path, init, message):
    with pytest.raises(KinfeasError, match=message):
        train(tiny(f"init={init}"), tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_a_checkpoint_from_before_a_key_was_there_resumes(half):
    path = half / "checkpoints" / "last" / "state.json"
    about = state(half)
    del about["config"]["physics"], about["config"]["init"]
    del about["config"]["learner"]["critic_steps"]
    path.write_text(json.dumps(about))
    assert resume(half).steps == 1600
