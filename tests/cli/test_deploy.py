import signal
import subprocess
import sys

import numpy as np
import pytest

from kinfeas.api.plan import load_plan
from kinfeas.config.recipes import ENGINES
from kinfeas.io.run_log import REACHED, read_record
from kinfeas.tasks.loading import load_task

HSR = ("--robot", "hsr", "--no-real-time")
GOAL = ("--backend", "analytic", "--goal", "0.9", "0.1", "0.8")
BRIEF = ("pretrained", *HSR, *GOAL, "--seconds", "0.1")


@pytest.fixture
def run(kinfeas, tmp_path):
    def deploy(*arguments, **checks):
        path = tmp_path / "run.csv"
        path.unlink(missing_ok=True)
        done = kinfeas("deploy", *arguments, "--record", "run.csv", "--json", "out.json", **checks)
        return done, read_record(path)

    return deploy


def test_goal_is_reached_and_recorded(run):
    words = ("--set", "generator.gain=1", "--rpy", "0", "1.2", "-0.3")
    done, record = run("pretrained", *HSR, *GOAL, *words, code=0)
    assert REACHED in done.out
    assert done.facts["reason"] == record.event[-1] == REACHED


EE_PATH = "time,x,y,z,qx,qy,qz,qw\n0,2.6,-0.6,0.9,0,0,0,1\n8,2.6,0.6,0.9,0,0,0,1\n"


@pytest.mark.parametrize("goal", [(), ("--goal", "9", "9", "0.2")])
def test_a_motion_in_the_world_has_its_own_goal(kinfeas, run, tmp_path, caplog, goal):
    (tmp_path / "ee.csv").write_text(EE_PATH)
    words = ("--set", "generator.file=ee.csv", "--set", "generator.frame=world", *goal)
    brief = ("pretrained", *HSR, "--backend", "analytic", "--seconds", "0.1", *words)
    _, record = run(*brief, "--generator", "waypoints", code=4)
    assert "ends at x 2.6, y 0.6, z 0.9 m" in caplog.text
    np.testing.assert_allclose(record.goal[-1, :3], [2.6, 0.6, 0.9])
    assert "'waypoints'" in kinfeas("deploy", *brief, "--generator", "replay", code=2).err


@pytest.mark.parametrize("robot", ["hsr", "tiago"])
def test_a_plan_is_carried_out_by_base_and_arm(kinfeas, run, tmp_path, robot):
    (tmp_path / "ee.csv").write_text(EE_PATH)
    words = ("--robot", robot, "--path", "ee.csv", "--out", "plan.csv", "--scene", "room")
    done = kinfeas("plan", *words, "--picture", "plan.png", "--json", "out.json", code=0)
    assert (tmp_path / "plan.png").read_bytes().startswith(b"\x89PNG")
    assert done.facts.keys() > {"joint_trajectory", "base_path"}
    plan, own = load_plan("plan.csv", robot), ("--robot", robot, "--no-real-time")
    _, record = run("--plan", "plan.csv", *own, "--backend", "analytic", code=0)
    assert record.feasible.all()
    assert "path_planner" not in {each.name for each in record.about.filters}  # plans anew
    for name, most in (("base_pose", 0.05), ("joint_positions", 0.3)):  # bases have inertia
        planned = np.stack([np.interp(record.time, plan.time, x) for x in getattr(plan, name).T], 1)
        deviation = np.abs(getattr(record, name) - planned)
        assert deviation.max() < most
        assert np.median(deviation) < 0.02
    joint = plan.joint_names[0]
    elsewhere = (tmp_path / "plan.csv").read_text().replace(joint, "joint")
    (tmp_path / "plan.csv").write_text(elsewhere)
    assert joint in kinfeas("deploy", "--plan", "plan.csv", *own, code=2).err
    assert "'robot'" in kinfeas("deploy", "--plan", "plan.csv", code=2).err
    words = ("--plan", "plan.csv", *own, "--set", "generator.gain=2")
    assert "generator" in kinfeas("deploy", *words, code=2).err
    assert "policy" in kinfeas("deploy", "pretrained", "--plan", "plan.csv", *own, code=2).err


@pytest.mark.parametrize("engine", ENGINES)
def test_task_with_physics_is_recorded_with_its_furniture(run, engine):
    pytest.importorskip(engine)
    words = ("--backend", engine, "--task", "pick_place", "--seconds", "0.1")
    done, record = run("follow_ee", *HSR, *words, code=4)
    assert done.facts["task_done"] is False
    assert record.about.scene == "room"
    assert set(record.about.objects) == set(load_task("pick_place").scene.moves)


def test_every_run_has_a_record(kinfeas, tmp_path):
    done = kinfeas("deploy", *BRIEF, "--set", "scene=room", code=4)
    assert done.err.startswith("stopped: ")
    (record,) = (tmp_path / "runs" / "deploy").glob("*-hsr-goal.csv")
    assert len(read_record(record).time) == 5 + 3  # one period brakes
    assert len(read_record(record).about.solids) > 10
    before = record.read_bytes()
    kinfeas("deploy", *BRIEF, code=4)
    assert len(list(record.parent.iterdir())) == 2
    assert record.read_bytes() == before


@pytest.mark.parametrize(("adapters", "words"), [
    ("randomised", ("pretrained", "--backend", "pybullet", "--goal", "0.9", "0.1", "0.8")),
    ("scans.yaml", ("pretrained", "--backend", "analytic", "--task", "ggr_obstacles")),
])  # fmt: skip
def test_adapters_for_physics_and_of_scans_deploy(run, tmp_path, adapters, words):
    (tmp_path / "scans.yaml").write_text("adapters: [{name: scan_noise}]")
    done, _ = run(*words, *HSR, "--adapters", adapters, "--seconds", "0.1", code=4)
    assert "not reached" in done.err


def test_guards_come_from_a_file_and_from_settings(run, tmp_path):
    (tmp_path / "guards.yaml").write_text("{max_linear_velocity: 0.05, max_distance: 0.02}")
    words = ("--guards", "guards.yaml", "--set", "guards.max_linear_velocity=0.02")
    done, record = run("pretrained", *HSR, *GOAL, *words, "--filters", "none", code=3)
    assert "at most 0.02 " in done.err
    speed = (record.base_twist[:, :2] ** 2).sum(axis=1) ** 0.5
    assert speed.max() == pytest.approx(0.02)


def test_unwritable_json_keeps_the_exit_code(kinfeas, tmp_path):
    words = ("--filters", "none", "--record", "run.csv", "--json", "/dev/full")
    done = kinfeas("deploy", "stationary", *BRIEF[1:], *words, code=4)  # it need not brake
    stopped, unwritten = done.err.splitlines()
    assert stopped.startswith("stopped: ")
    assert unwritten.startswith("--json: /dev/full")
    assert len(read_record(tmp_path / "run.csv").time) == 5 + 2


@pytest.mark.slow
@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (signal.SIGKILL, -9)])
def test_record_survives_signals(tmp_path, number, code):
    path = tmp_path / "run.csv"
    words = ("deploy", "pretrained", "--robot", "hsr", *GOAL, "--record", str(path))
    process = subprocess.Popen([sys.executable, "-m", "kinfeas", *words], stderr=subprocess.PIPE)
    while process.poll() is None and (not path.exists() or path.read_text().count("\n") < 10):
        pass
    process.send_signal(number)
    process.communicate(timeout=60)
    assert process.returncode == code
    record = read_record(path)
    assert len(record.time) >= 8
    assert number is signal.SIGKILL or not record.base_twist[-1].any()
