import json
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from kinfeas.config.recipes import ENGINES
from kinfeas.io.run_log import REACHED, read_record
from kinfeas.robots.loading import load_robot
from kinfeas.tasks.loading import load_task
from tests.builders import wait
from tests.cli.test_main import HEAVY, kinfeas_process

OWN_ROBOT = Path(__file__).parents[2] / "examples" / "own_robot"
HSR = ("--robot", "hsr", "--no-real-time")
QUICK = ("--set", "generator.gain=1")
GOAL = ("--backend", "analytic", "--goal", "0.9", "0.1", "0.8")
BRIEF = ("pretrained", *HSR, *GOAL, "--seconds", "0.1")


@pytest.fixture
def run(kinfeas, tmp_path):
    def deploy(*arguments, **checks):
        path = tmp_path / "run.csv"
        path.unlink(missing_ok=True)
        done = kinfeas("deploy", *arguments, "--record", "run.csv", "--json", "run.json", **checks)
        return done, read_record(path)

    return deploy


def test_goal_is_reached_and_recorded(run, tmp_path):
    done, record = run("pretrained", *HSR, *GOAL, *QUICK, "--rpy", "0", "1.2", "-0.3", code=0)
    assert REACHED in done.out
    assert record.event[-1] == REACHED
    assert json.loads((tmp_path / "run.json").read_text())["reason"] == REACHED


@pytest.mark.parametrize("engine", ENGINES)
def test_task_with_physics_is_recorded_with_its_furniture(run, tmp_path, engine):
    pytest.importorskip(engine)
    words = ("--backend", engine, "--task", "pick_place", "--seconds", "0.1")
    _, record = run("follow_ee", *HSR, *words, code=4)
    assert json.loads((tmp_path / "run.json").read_text())["task_done"] is False
    assert record.about.scene == "room"
    assert set(record.about.objects) == set(load_task("pick_place").scene.moves)


def test_a_scene_is_around_the_robot(run):
    _, record = run(*BRIEF, "--set", "scene=room", code=4)
    assert len(record.about.solids) > 10


def test_every_run_has_a_record(kinfeas, tmp_path):
    done = kinfeas("deploy", *BRIEF, code=4)
    assert done.err.startswith("stopped: ")
    (record,) = (tmp_path / "runs" / "deploy").glob("*-hsr-goal.csv")
    assert len(read_record(record).time) == 5 + 2
    before = record.read_bytes()
    for _ in range(2):  # also within a second
        kinfeas("deploy", *BRIEF, code=4)
    assert len(list(record.parent.iterdir())) == 3
    assert record.read_bytes() == before


@pytest.mark.parametrize(("adapters", "words"), [
    ("randomised", ("pretrained", "--backend", "pybullet", "--goal", "0.9", "0.1", "0.8")),
    ("scans.yaml", ("rooms", "--backend", "analytic", "--task", "ggr_obstacles")),
])  # fmt: skip
def test_adapters_for_physics_and_of_scans_deploy(run, tmp_path, adapters, words):
    (tmp_path / "scans.yaml").write_text("adapters: [{name: scan_noise}]")
    done, _ = run(*words, *HSR, "--adapters", adapters, "--seconds", "0.1", code=4)
    assert "not reached" in done.err


def test_guards_come_from_a_file_and_from_settings(run, tmp_path):
    (tmp_path / "guards.yaml").write_text("{max_linear_velocity: 0.05, max_distance: 0.02}")
    words = ("--guards", "guards.yaml", "--set", "guards.max_linear_velocity=0.02")
    done, record = run("pretrained", *HSR, *GOAL, *words, code=3)
    assert "at most 0.02 " in done.err
    speed = (record.base_twist[:, :2] ** 2).sum(axis=1) ** 0.5
    assert speed.max() == pytest.approx(0.02)


def test_unwritable_json_keeps_the_exit_code(kinfeas, tmp_path):
    done = kinfeas("deploy", *BRIEF, "--record", "run.csv", "--json", "/dev/full", code=4)
    stopped, unwritten = done.err.splitlines()
    assert stopped.startswith("stopped: ")
    assert unwritten.startswith("--json: /dev/full")
    assert len(read_record(tmp_path / "run.csv").time) == 5 + 2


@pytest.mark.parametrize("policy", ["run", "tiago.onnx"])
def test_policy_moves_its_robot(run, kinfeas, tmp_path, policy):
    shutil.copytree(load_robot("tiago").folder / "policies" / "pretrained", tmp_path / "run")
    if policy != "run":
        kinfeas("export", "run", "--out", policy, code=0)
    _, record = run(policy, *GOAL, "--no-real-time", "--seconds", "0.1", code=4)
    assert record.about.robot == "tiago"


@pytest.mark.slow
def test_no_learning_or_drawing_library_is_imported(tmp_path):
    heavy = {"torch", "stable_baselines3", "sklearn", "matplotlib", "pybullet", "onnxruntime"}
    words = ("deploy", *BRIEF, "--record", str(tmp_path / "run.csv"))
    done = kinfeas_process(HEAVY % heavy, *words)
    assert (done.returncode, done.stderr.splitlines()[-1]) == (4, "heavy: []")


@pytest.mark.slow
@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (signal.SIGKILL, -9)])
def test_record_survives_signals(tmp_path, number, code):
    path = tmp_path / "run.csv"
    code_line = "from kinfeas.cli.main import main; main()"
    words = ("deploy", "pretrained", "--robot", "hsr", *GOAL, "--record", str(path))
    process = subprocess.Popen([sys.executable, "-c", code_line, *words], stderr=subprocess.PIPE)
    wait(lambda: path.exists() and path.read_text().count("\n") >= 10)
    process.send_signal(number)
    process.communicate(timeout=60)
    assert process.returncode == code
    record = read_record(path)
    assert len(record.time) >= 8
    assert number is signal.SIGKILL or not record.base_twist[-1].any()
