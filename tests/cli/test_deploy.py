import json
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from kinfeas.backends.analytic import AnalyticBackend
from kinfeas.cli import deploy
from kinfeas.cli.examples import EXAMPLES
from kinfeas.core import registry
from kinfeas.io.run_log import REACHED, About, read_record
from kinfeas.policies import pretrained
from kinfeas.tasks.loading import load_task
from tests.cli.conftest import is_one_line


class Clinging(AnalyticBackend):
    """A world that cannot be closed."""

    def close(self):
        raise RuntimeError("still busy")


QUICK = ("--set", "generator.gain=1", "--set", "slow_down=1")
GOAL = ("--backend", "analytic", "--goal", "0.9", "0.1", "0.8")
OWN_ROBOT = Path(__file__).parents[2] / "examples" / "own_robot"
MAIN = "from kinfeas.cli.main import main; main()"
HEAVY = """
import sys
from kinfeas.cli import main
try:
    main.main()
finally:
    heavy = {"torch", "stable_baselines3", "sklearn", "matplotlib", "pybullet", "onnxruntime",
             "scipy.stats", "scipy.optimize", "kinfeas.policies.baselines"}
    print("imported:", sorted(heavy & set(sys.modules)))
"""


def started(code, *arguments):
    command = [sys.executable, "-c", code, "deploy", "pretrained", *arguments]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def test_drives_to_a_goal_and_records_it(kinfeas, tmp_path):
    done = kinfeas("deploy", "pretrained", *GOAL, *QUICK, "--no-real-time", "--rpy", "0",
                   "1.2", "-0.3", "--record", "run.csv", "--json", "run.json")  # fmt: skip
    assert done.code == 0, done.err
    assert REACHED in done.out
    record = read_record(tmp_path / "run.csv")
    assert record.event[-1] == REACHED
    assert json.loads((tmp_path / "run.json").read_text())["reason"] == REACHED


def test_a_task_in_the_simulated_world_is_recorded_with_its_furniture(kinfeas, tmp_path):
    pytest.importorskip("pybullet")
    done = kinfeas("deploy", "follow_ee", "--robot", "pr2", "--task", "pick_place",
                   "--seconds", "0.1", "--no-real-time", "--record", "run.csv", "--json",
                   "run.json")  # fmt: skip
    assert done.code == 4, done.err
    assert json.loads((tmp_path / "run.json").read_text())["task_done"] is False
    assert "task not done" in " ".join(done.out.split())
    about = read_record(tmp_path / "run.csv").about
    assert about.scene == "room"
    assert set(about.objects) == set(load_task("pick_place").scene.moves)
    page = kinfeas("view", "--record", "run.csv", "--picture", "run.png")
    assert page.code == 0, page.err


def test_looking_ahead_carries_on_where_the_policy_alone_gets_stuck(kinfeas, tmp_path):
    wide = ("--backend", "analytic", "--robot", "tiago", "--task", "ggr", "--seed", "7",
            "--set", "feasibility_filter=false")  # fmt: skip
    runs, ahead = {}, ("--rollout-planner",)
    more_of_it = (*ahead, "--set", "rollout.num_samples=32", "--set", "rollout.horizon=6")
    for name, more in (("alone", ()), ("ahead", ahead), ("again", more_of_it)):
        done = kinfeas("deploy", "pretrained", *wide, "--seconds", "30", "--no-real-time",
                       "--record", f"{name}.csv", *more)  # fmt: skip
        runs[name] = done.code, read_record(tmp_path / f"{name}.csv")
    assert [code for code, _ in runs.values()] == [3, 4, 4]
    assert runs["ahead"][1].about.policy == "rollout_planner:pretrained"
    # Without a clock it is the same each time.
    assert (runs["ahead"][1].base_pose == runs["again"][1].base_pose).all()


def test_looks_ahead_beside_a_clock(kinfeas, tmp_path):
    done = kinfeas("deploy", "pretrained", *GOAL, *QUICK, "--seconds", "1.5", "--rollout-planner",
                   "--record", "run.csv", "--json", "run.json")  # fmt: skip
    assert done.code == 4, done.err
    assert json.loads((tmp_path / "run.json").read_text())["timing"]["p50"] < 0.04
    assert read_record(tmp_path / "run.csv").feasible.all()


def test_records_every_run_and_says_where(kinfeas, tmp_path):
    done = kinfeas("deploy", "pretrained", *GOAL, "--no-real-time", "--seconds", "0.1")
    assert done.code == 4
    assert done.err == "stopped: the goal was not reached within 0.1 s\n"
    (record,) = (tmp_path / "runs" / "deploy").glob("*-pr2-goal.csv")
    assert len(read_record(record).time) == 5 + 2


def test_a_record_names_an_own_robot_for_readers_elsewhere(kinfeas, tmp_path, monkeypatch):
    shutil.copytree(OWN_ROBOT, tmp_path / "own")
    done = kinfeas("deploy", "follow_ee", "--robot", "own/scout.yaml", *GOAL, "--seconds", "0.1",
                   "--no-real-time", "--record", "run.csv")  # fmt: skip
    assert done.code == 4, done.err
    assert read_record(tmp_path / "run.csv").about.robot == str(tmp_path / "own" / "scout.yaml")
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert kinfeas("view", "--record", "../run.csv").code == 0


def test_adapters_stand_between(kinfeas, tmp_path):
    (tmp_path / "mine.yaml").write_text(
        "adapters: [{name: base_noise, parameters: {linear: 0.05}}]"
    )
    for name, more in (("a.csv", ()), ("b.csv", ("--adapters", "mine.yaml"))):
        kinfeas("deploy", "pretrained", *GOAL, "--no-real-time", "--seconds", "0.2",
                "--record", name, *more)  # fmt: skip
    paths = [read_record(tmp_path / name).base_pose[-1, :2].tolist() for name in ("a.csv", "b.csv")]
    assert paths[0] != paths[1]


def test_guards_come_from_a_file_and_from_the_command_line(kinfeas, tmp_path):
    (tmp_path / "guards.yaml").write_text("{max_linear_velocity: 0.05, max_distance: 0.02}")
    done = kinfeas("deploy", "pretrained", *GOAL, "--no-real-time", "--record", "run.csv",
                   "--guards", "guards.yaml",
                   "--set", "guards.max_linear_velocity=0.02")  # fmt: skip
    assert done.code == 3
    assert "m from its start" in done.err
    speed = (read_record(tmp_path / "run.csv").base_twist[:, :2] ** 2).sum(axis=1) ** 0.5
    assert speed.max() == pytest.approx(0.02)


@pytest.mark.parametrize(("arguments", "message"), [
    (GOAL[:2], "say where to go: --goal X Y Z, or --task NAME or FILE"),
    ((*GOAL, "--task", "door"), "--goal and --task exclude each other"),
    ((*GOAL, "--rpy", "0", "0", "0", "--quaternion", "0", "0", "0", "1"), "exclude each other"),
    ((*GOAL, "--quaternion", "0", "0", "0", "2"), "must be of length 1, not 2"),
    ((*GOAL, "--robot", "tiago", "--goal", "nan", "0", "0"), "finite numbers"),
    (("--backend", "analytik", *GOAL[2:]), "unknown backend 'analytik' (did you mean 'analytic'?)"),
    ((*GOAL, "--set", "guards.sped=1"), "guards.sped"),
    ((*GOAL, "--set", "guards.max_linear_velocity=-1"), "_linear_velocity' must be a number > 0"),
    ((*GOAL, "--set", "head_start=1e300"), "'head_start' must be a number in [0, 100000], not 1e"),
    ((*GOAL, "--set", "guards.watchdog=1e300"), "'guards.watchdog' must be a number in (0, 100000"),
    ((*GOAL, "--set", "backend.wheels=3"), "unknown parameter 'wheels'"),
    ((*GOAL, "--set", "task.orientation=so3"), "--set task.KEY needs --task"),
    ((*GOAL[:2], "--task", "ggr", *QUICK), "--set generator.KEY and --task exclude each other"),
    ((*GOAL[:2], "--task", "ggr", "--rpy", "0", "0", "0"), "--rpy and --task exclude each other"),
    ((*GOAL, "--adapters", ""), "unknown configuration ''; known are harsh, ideal"),
    (("--backend", "pybullet", *GOAL[2:], "--set", "backend.scene=room"),
     "backend 'pybullet': the parameter 'scene' follows from the run"),
    (("--backend", "pybullet", *GOAL[2:], "--set", "backend.physics={gravity: -1}"),
     "'physics.gravity' must be a number >= 0, not -1"),
    (("--backend", "ros1", *GOAL[2:], "--set", "backend.timeout=soon"),
     "'timeout' must be a finite number, not 'soon'"),
    ((*GOAL, "--set", "rollout.num_samples=8"), "--set rollout.KEY needs --rollout-planner"),
    ((*GOAL, "--rollout-planner", "--set", "rollout.num_samples=0"),
     "'rollout.num_samples' must be a whole number in [1, 1000], not 0"),
    ((*GOAL, "--rollout-planner", "--set", "rollout.horizon=0"),
     "'rollout.horizon' must be a number in [0.1, 100000], not 0"),
    ((*GOAL, "--generator", "linea"), "unknown motion generator 'linea'"),
    ((*GOAL, "--rate", "5"), "guards.max_age of 0.2 s needs a rate of at least 7.5 Hz, not 5 Hz"),
    ((*GOAL, "--record", "/nowhere/run.csv"), "cannot be written"),
    ((*GOAL, "--guards", "none.yaml"), "none.yaml: cannot be read"),
])  # fmt: skip
def test_bad_input_is_one_line(kinfeas, arguments, message):
    done = kinfeas("deploy", "pretrained", *arguments)
    assert done.code == 2
    assert message in done.err
    assert done.err.startswith("error: ")
    assert done.err.count("\n") == 1


@pytest.mark.parametrize(
    ("policy", "message"),
    [("", "the name of the policy is empty"), (".", ".: not a training run or checkpoint")],
)
def test_a_folder_without_a_policy_is_none(kinfeas, policy, message):
    done = kinfeas("deploy", policy, *GOAL)
    assert is_one_line(done)
    assert message in done.err


@pytest.mark.parametrize("command", ["deploy", "simulate"])
def test_a_robot_without_topics_is_told_how_to_name_them(kinfeas, command):
    robot = ("--robot", str(OWN_ROBOT / "scout.yaml"), "--backend", "ros2")
    deployed = command == "deploy"
    done = kinfeas(command, *(("follow_ee", *GOAL[2:]) if deployed else ()), *robot)
    assert is_one_line(done)
    option = "--set backend.topics=FILE" if deployed else "--topics FILE"
    assert done.err.endswith(f"known are hsr, pr2, tiago, or a YAML file: {option}\n")


def test_a_run_that_cannot_begin_leaves_no_record(kinfeas, tmp_path):
    done = kinfeas("deploy", "pretrained", "--backend", "ros1", *GOAL[2:])
    assert is_one_line(done)
    assert not list(tmp_path.rglob("*.csv"))


def test_an_unwritable_json_does_not_hide_the_run(kinfeas, tmp_path):
    done = kinfeas("deploy", "pretrained", *GOAL, "--no-real-time", "--seconds", "0.1",
                   "--record", "run.csv", "--json", "/dev/full")  # fmt: skip
    assert done.code == 4
    assert "control period, median" in done.out
    stopped, unwritten = done.err.splitlines()
    assert stopped == "stopped: the goal was not reached within 0.1 s"
    assert unwritten.startswith("--json: /dev/full: cannot be written")
    assert len(read_record(tmp_path / "run.csv").time) == 5 + 2


def test_a_backend_that_cannot_be_closed_does_not_hide_the_run(kinfeas, tmp_path, monkeypatch):
    monkeypatch.setattr(registry, "_REGISTERED", [])
    registry.register("kinfeas.backends", "clinging", Clinging)
    done = kinfeas("deploy", "pretrained", "--backend", "clinging", *GOAL[2:], *QUICK,
                   "--no-real-time", "--record", "run.csv",
                   "--json", "run.json")  # fmt: skip
    assert done.code == 0
    assert REACHED in done.out
    blamed = "still busy"
    assert done.err.startswith(f"the backend could not be closed: {blamed}")
    assert done.err.count("\n") == 1
    assert read_record(tmp_path / "run.csv").event[-1] == REACHED
    assert json.loads((tmp_path / "run.json").read_text())["unclosed"].startswith(blamed)


@pytest.mark.parametrize(
    ("task", "end"),
    [("tidy-up_2", "tidy-up_2"), ("a/b", "a_b"), ("../../up", "______up"), ("* ?", "___")],
)
def test_a_task_of_any_name_is_recorded_in_one_folder(tmp_path, monkeypatch, task, end):
    monkeypatch.chdir(tmp_path)
    started = "2026-01-02T03:04:05+00:00"
    about = About("pr2", task, "pretrained", "analytic", 0.02, ("elbow",), started)
    path = deploy._record_path(about)
    assert path == Path("runs") / "deploy" / f"20260102-030405-pr2-{end}.csv"


def test_runs_that_begin_at_once_are_recorded_apart(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    about = About("pr2", "goal", "p", "analytic", 0.02, (), "2026-01-02T03:04:05+00:00")
    for end in ("goal.csv", "goal-2.csv", "goal-3.csv"):
        path = deploy._record_path(about)
        assert path.name == f"20260102-030405-pr2-{end}"
        path.touch()


def test_a_record_is_never_written_over(kinfeas, tmp_path):
    (tmp_path / "run.csv").write_text("mine")
    done = kinfeas("deploy", "pretrained", *GOAL, "--record", "run.csv")
    assert is_one_line(done)
    assert "--record: run.csv exists, and a record is never written over" in done.err
    assert (tmp_path / "run.csv").read_text() == "mine"


def test_help_names_baselines_as_policies(kinfeas):
    assert "follow_ee" in kinfeas("deploy", "--help").out


def test_help_says_what_a_goal_is_the_pose_of_and_in_which_frame(kinfeas, monkeypatch):
    monkeypatch.setenv("COLUMNS", "400")
    (line,) = (one for one in kinfeas("deploy", "--help").out.splitlines() if "--goal  " in one)
    for words in ("EE frame", "robot's YAML", "the frame that the backend measures the base in"):
        assert words in line


def test_an_example_that_slows_the_base_down_slows_the_hand_down_as_much():
    creeping = [one for one in EXAMPLES["deploy"] if "guards.max_linear_velocity=0.05" in one]
    assert creeping
    for example in creeping:
        assert "--set slow_down=4" in example  # a quarter of the 0.2 m/s of all three robots
        assert "--set guards.max_angular_velocity" in example


def test_drives_the_robot_that_the_policy_was_trained_for(kinfeas, tmp_path):
    assert kinfeas("export", "pretrained", "--robot", "tiago", "--out", "tiago.onnx").code == 0
    for number, policy in enumerate((str(pretrained.find("tiago")), "tiago.onnx")):
        done = kinfeas("deploy", policy, *GOAL, "--no-real-time", "--seconds", "0.1",
                       "--record", f"{number}.csv")  # fmt: skip
        assert done.code == 4, done.err
        assert read_record(tmp_path / f"{number}.csv").about.robot == "tiago"


def test_a_policy_of_another_robot_is_refused(kinfeas):
    done = kinfeas("deploy", str(pretrained.find("tiago")), *GOAL, "--robot", "pr2")
    assert is_one_line(done)
    assert "a policy for robot 'tiago'" in done.err


HIGH = ("--backend", "analytic", "--goal", "1.5", "0", "2.2")


def test_a_goal_out_of_reach_is_refused_before_anything_moves(kinfeas, tmp_path):
    done = kinfeas("deploy", "pretrained", *HIGH)
    assert is_one_line(done)
    assert "from which the arm reaches the goal, x 1.5, y 0, z 2.2 m, roll 0, pitch 0" in done.err
    assert "guards.reach=false" in done.err
    assert not list(tmp_path.rglob("*.csv"))
    done = kinfeas("deploy", "pretrained", *HIGH, "--no-real-time", "--seconds", "0.1",
                   "--set", "guards.reach=false")  # fmt: skip
    assert (done.code, done.err) == (4, "stopped: the goal was not reached within 0.1 s\n")


def test_the_end_of_a_leg_out_of_reach_is_refused(kinfeas, tmp_path):
    place = "{position: [1.5, 0, %s], rpy: [0, 0, 0]}"
    places = f"places: {{low: {place % 0.8}, high: {place % 2.2}}}"
    (tmp_path / "up.yaml").write_text(
        f"name: up\n{places}\nsubgoals: [{{place: low}}, {{place: high}}]"
    )
    done = kinfeas("deploy", "pretrained", "--backend", "analytic", "--task", "up.yaml")
    assert is_one_line(done)
    assert "the arm reaches the end of sub-goal 2 of 2, x 1.5, y 0, z 2.2 m" in done.err


@pytest.mark.parametrize(("more", "warns"), [((), True), (("--set", "slow_down=4"), False)])
def test_a_hand_that_would_outrun_the_base_is_warned_of(kinfeas, more, warns):
    done = kinfeas("deploy", "pretrained", "--robot", "hsr", *GOAL[:2], "--goal", "-1.5", "1.0",
                   "0.9", "--set", "guards.max_linear_velocity=0.05", *more, "--no-real-time",
                   "--seconds", "0.1")  # fmt: skip
    first, *rest = done.err.splitlines()
    assert (
        first.startswith("guards.max_linear_velocity limits"),
        len(rest),
    ) == (warns, warns)
    assert ("slow_down=4" in first) is warns


def test_imports_nothing_heavy(tmp_path):
    process = started(HEAVY, *GOAL, "--no-real-time", "--seconds", "0.1",
                      "--record", str(tmp_path / "run.csv"))  # fmt: skip
    out, err = process.communicate(timeout=120)
    assert process.returncode == 4, err
    assert out.splitlines()[-1] == "imported: []"


def test_a_run_ends_by_a_signal_and_its_record_outlives_a_kill(tmp_path):
    ends = {signal.SIGTERM: 143, signal.SIGKILL: -9}
    runs = {}
    for number in ends:
        path = tmp_path / f"{number}.csv"
        runs[number] = (started(MAIN, *GOAL, "--record", str(path)), path)
    for number, (process, path) in runs.items():
        end = time.monotonic() + 60.0
        while not path.exists() or path.read_text().count("\n") < 10:
            assert time.monotonic() < end
            time.sleep(0.05)
        process.send_signal(number)
    for number, (process, path) in runs.items():
        _, err = process.communicate(timeout=20)
        assert process.returncode == ends[number]
        record = read_record(path)
        assert len(record.time) >= 8
        if number is not signal.SIGKILL:
            assert err.endswith(f"stopped: {record.event[-1]}\n")
            assert not record.base_twist[-1].any()
