import json
import re
import shutil
import sys
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

from kinfeas.backends.analytic import AnalyticBackend
from kinfeas.config.recipes import default_engine
from kinfeas.io.demonstrations import demonstration_files, read_demonstration
from kinfeas.io.run_log import read_record
from kinfeas.plugins.imitation import GaussianMixture, Imitation
from kinfeas.robots.loading import load_robot
from tests.cli.conftest import check_one_line, write_demonstrations

EXAMPLES = Path(__file__).parents[2] / "examples"


def test_export_and_check_show_the_same_metadata(kinfeas, tmp_path):
    shutil.copytree(load_robot("hsr").folder / "policies" / "pretrained", tmp_path / "run")
    words = ("--robot", "hsr", "--json", "out.json")
    exported = kinfeas("export", "run", "--out", "hsr.onnx", *words, code=0).facts
    assert 0.0 <= exported.pop("parity") <= 1e-5
    outcome = kinfeas("export", "--check", "hsr.onnx", *words, code=0)
    assert outcome.facts == exported
    assert "arm_lift_joint" in outcome.out
    assert "fits hsr" in kinfeas("export", "--check", "hsr.onnx", code=0).out


@pytest.mark.parametrize(
    ("generator", "kind", "components"),
    [(Imitation, "imitation", 8), (GaussianMixture, "gaussian_mixture", 5)],
)
def test_generator_follows_the_model(kinfeas, tmp_path, generator, kind, components):
    write_demonstrations(tmp_path / "shown", 4)
    words = ("shown", "--out", "door.yaml", "--json", "out.json")
    words += ("--kind", kind, "--components", str(components))
    figures = kinfeas("fit", *words, code=0).facts
    generator(model="./door.yaml")
    assert (figures["demonstrations"], figures["base"]) == (4, True)
    assert figures["components"] == components
    assert max(figures["position_residual_m"]) < 0.04
    text = (tmp_path / "door.yaml").read_text()
    assert "kinfeas fit shown" in text
    assert str(tmp_path) not in text


@pytest.mark.parametrize(("count", "change", "warned"), [
    (1, None, "one demonstration"), (6, "copy", "copies"), (6, "far", "far from.*: 0.csv"),
    (6, "base", "no base motion"), (6, None, ""), (3, "reversed", "far from.*: 0.csv"),
])  # fmt: skip
def test_a_fit_to_odd_demonstrations_gives_a_warning(kinfeas, tmp_path, count, change, warned):
    write_demonstrations(tmp_path / "shown", count)
    first, *others = sorted((tmp_path / "shown").iterdir())
    table = np.loadtxt(first, delimiter=",", skiprows=1)
    header = first.read_text().partition("\n")[0]
    if change == "far":
        table[:, 2] += 3.0
    if change == "reversed":
        table[:, 1:8] = table[::-1, 1:8]
    if change == "base":
        header = header.replace("base", "hand")
    np.savetxt(first, table, delimiter=",", header=header, comments="")
    for other in others if change == "copy" else ():
        shutil.copy(first, other)
    sources = [str(first), *map(str, others)] if change == "copy" else ["shown"]
    done = kinfeas("fit", *sources, "--out", "door.yaml", code=0)
    assert done.err.count("warning") == bool(warned)
    assert re.search(warned, done.err)


def test_replay_of_a_run(kinfeas, tmp_path):
    words = ("--robot", "hsr", "--backend", "analytic", "--goal", "1", "0", "0.8", "--seed", "5")
    (tmp_path / "noise.yaml").write_text("adapters: [{name: base_noise, linear: 0.05}]")
    words += ("--adapters", "noise.yaml", "--filters", "time_scaling")
    words += ("--set", "generator.gain=0.5", "--set", "guards.max_distance=3")
    kinfeas("deploy", "pretrained", *words, "--no-real-time", "--seconds", "0.2",
            "--record", "run.csv")  # fmt: skip
    words = ("--record", "run.csv", "--picture", "run.png", "--json", "out.json")
    facts = kinfeas("view", *words, code=0).facts
    assert (tmp_path / "run.png").read_bytes().startswith(b"\x89PNG")
    assert facts["events"][0]["event"] == "start"
    # It brakes for a second: the noise keeps it from coming to rest.
    assert (facts["seconds"], facts["steps"]) == (pytest.approx(0.2 + 1.0), 10 + 50)
    assert (facts["seed"], facts["guards"]["max_distance"]) == (5, 3.0)
    assert facts["adapters"] == [{"name": "base_noise", "parameters": {"linear": 0.05}}]
    assert facts["filters"] == [{"name": "time_scaling", "parameters": {}}]
    assert facts["generators"] == [{"name": "linear", "parameters": {"gain": 0.5}}]
    record = tmp_path / "run.csv"
    record.write_bytes(record.read_bytes()[:-300].replace(b'"scene": ""', b'"scene": "room"'))
    kinfeas("view", "--record", "run.csv", code=0)
    pytest.importorskip("viser")
    kinfeas("view", "--record", "run.csv", "--html", "run.html", code=0)
    assert "furniture as at the start" in (tmp_path / "run.html").read_text()


SCENE = "{name: 'm[/x]', size: [4, 4], objects: {'t[b]': {urdf: table.urdf}}}"


def test_own_scene_as_table_picture_and_page(kinfeas, tmp_path):
    pytest.importorskip("viser")
    (tmp_path / "mine.yaml").write_text(SCENE)
    done = kinfeas(
        "view", "--scene", "mine.yaml", "--picture", "mine.png", "--html", "mine.html", code=0
    )
    assert "scene m[/x]" in done.out
    assert "t[b]" in done.out
    assert (tmp_path / "mine.png").read_bytes().startswith(b"\x89PNG")
    assert (tmp_path / "mine.html").stat().st_size > 1000


def test_base_poses_of_an_ee_pose_or_the_object_in_the_way(kinfeas, tmp_path):
    words = ("reach", "--robot", "hsr", "--scene", "room", "--json", "out.json")
    pose = ("--pose", "1", "0", "0.8", *"000")
    (answer,) = kinfeas(*words, *pose, "--picture", "map.png", code=0).facts
    assert (len(answer["base_pose"]), answer["limit"]) == (8, "")
    assert (tmp_path / "map.png").read_bytes().startswith(b"\x89PNG")
    outcome = kinfeas(*words, "--pose", "3", "0", "0.55", *"000", code=0)
    (answer,) = outcome.facts
    assert (answer["reachable"], answer["solids"]) == (False, ["pick_table"])
    assert "pick_table" in outcome.out


def test_other_commands_take_an_imported_robot(kinfeas, tmp_path, monkeypatch):
    monkeypatch.setattr("kinfeas.importer.reach._GOALS", 8)  # the full number takes a minute
    monkeypatch.setattr("kinfeas.importer.reach._STAGES", (4, 16))
    words = ("robot", "import", str(EXAMPLES / "own_robot" / "robot.urdf"), "--out", "new")
    outcome = kinfeas(*words, "--json", "out.json", "--picture", "new.png", code=0)
    facts = outcome.facts
    assert "kinfeas ceiling --robot ./new\n" in outcome.out
    robot = load_robot(tmp_path / "new")
    assert list(facts["arm"]) == [joint.name for joint in robot.arm]
    assert len(facts["heights_m"]) == len(facts["reachable"])
    assert (tmp_path / "new.png").read_bytes().startswith(b"\x89PNG")
    short = ("--policy", "follow_ee", "--episodes", "1", "--set", "world.max_seconds=1")
    kinfeas("evaluate", "--robot", "./new", *short, code=0)
    check_one_line(kinfeas(*words), "new/robot.yaml")


RELAXED = (
    "--set", "guards.max_age=5", "--set", "guards.max_period=5", "--set", "guards.max_clock_skew=5",
)  # fmt: skip
"""Guards of time for a busy machine."""


def test_the_ee_follows_a_source_of_the_working_directory(kinfeas, tmp_path):
    pytest.importorskip("mujoco")
    shutil.copy(EXAMPLES / "target_source.py", tmp_path / "circles.py")
    facts = kinfeas(
        "servo", "--robot", "pr2", "--backend", "mujoco", "--source", "circles:Circle",
        "--seconds", "2", "--record", "run.csv", "--json", "out.json", *RELAXED, code=0,
    ).facts  # fmt: skip
    assert (facts["failures"], facts["time_scale"]) == (0, 1.0)
    lines = [line.split(",") for line in (tmp_path / "run.csv").read_text().splitlines()[1:]]
    column = lines[0].index("desired.y")
    assert lines[1][column] != lines[-1][column]
    kinfeas("dataset", "run.csv", "--out", "shown", "--kind", "csv", code=0)
    (shown,) = map(read_demonstration, demonstration_files(tmp_path / "shown"))
    assert np.ptp(shown.ee_pose[:, 1]) > 1e-3
    assert shown.has_base
    kinfeas("dataset", "shown", "run.csv", "--out", "set", code=0)
    about = json.loads((tmp_path / "set/meta/info.json").read_text())
    assert about["total_episodes"] == 2


SOURCE = """
import sys, threading
class Source:
    def __init__(self, fails: str):
        self.fails = fails
    def start(self, controller):
        if self.fails == "start":
            sys.exit(0)
        threading.Thread(target=self.send, args=(controller,)).start()
    def send(self, controller):
        controller.set_twist([0.0] * 5)
        while not controller.running:
            pass
        if self.fails == "thread":
            raise LookupError("no tracker")
    def close(self):
        if self.fails == "close":
            raise OSError("still open")
"""


@pytest.mark.parametrize(("fails", "code", "error"), [
    ("start", 2, "raised SystemExit"),
    ("thread", 3, "raised LookupError: no tracker"),
    ("close", 3, "still open"),
])  # fmt: skip
def test_a_target_source_that_fails_ends_the_run_and_is_named(
    kinfeas, tmp_path, monkeypatch, fails, code, error
):
    monkeypatch.setattr("threading.excepthook", lambda arguments: None)
    (tmp_path / "broken.py").write_text(SOURCE)
    monkeypatch.delitem(sys.modules, "broken", raising=False)
    done = kinfeas(
        "servo", "--robot", "hsr", "--backend", "analytic", "--source", "broken:Source",
        "--set", f"source.fails={fails}", "--seconds", "0.5", "--record", "run.csv", *RELAXED,
        "--json", "out.json", code=code,
    )  # fmt: skip
    assert "target source 'broken:Source'" in done.err
    assert error in done.err
    if fails != "start":
        assert not read_record(tmp_path / "run.csv").base_twist[-1].any()
        assert "messages" in done.facts


@pytest.mark.parametrize("path", ["-", "/dev/stdout"])
def test_json_on_standard_output_is_alone_there(kinfeas, tmp_path, path):
    done = kinfeas("plugins", "check", "linear", "--duration", "60", "--json", path, code=0)
    assert json.loads(done.out)["passed"] is True
    assert "motion generator linear" in done.err
    assert list(tmp_path.iterdir()) == []
    assert "linear" in kinfeas("plugins", "check", "linear", "--duration", "60").out


PLANNED = ["obstacle_distance", "path_planner", "feasibility"]
EVALUATE = ("evaluate", "--policy", "follow_ee", "--robot", "hsr", "--episodes", "1")
SHORT = (*EVALUATE, "--set", "world.max_seconds=0.5")
ENGINE = default_engine()


def test_an_evaluation_whose_backend_cannot_be_closed_keeps_its_result(
    kinfeas, monkeypatch, caplog
):
    monkeypatch.setattr(AnalyticBackend, "close", Mock(side_effect=LookupError("still open")))
    done = kinfeas(*SHORT, "--json", "out.json", code=0)
    assert "still open" in caplog.text
    assert done.facts["episodes"] == 1
    assert "goal reached" in done.out


@pytest.fixture
def evaluate(kinfeas):
    """Return a function that returns the JSON of `kinfeas evaluate`."""
    return lambda *arguments: kinfeas(*arguments, "--json", "out.json", code=0).facts


def test_options_of_physics(evaluate):
    words = ("--world", ENGINE, "--task", "drawer", "--no-objects")
    words += ("--robot", "tiago")
    figures = evaluate(*SHORT, *words, "--head-start", "0.2", "--time-scale", "0.5")
    assert (figures["head_start"], figures["time_scale"]) == (0.2, 0.5)
    assert (figures["task_success"], figures["filters"]) == (None, PLANNED)
    assert figures["dt"] == 0.02
    assert figures["base_collisions"] is not None
    names = ["obstacle_distance", "feasibility"]
    assert evaluate(*SHORT, *words, "--filters", ",".join(names))["filters"] == names
    assert evaluate(*SHORT, *words, "--filters", "none")["filters"] == []


def test_adapters_of_a_file(evaluate, tmp_path):
    (tmp_path / "mine.yaml").write_text("adapters: [base_noise, {name: head_start, seconds: 1}]")
    figures = evaluate(*SHORT, "--adapters", "mine.yaml", "--ablation")
    assert (figures["adapters"], figures["head_start"]) == (["base_noise", "head_start"], 1.0)
    one, other = ["base_noise"], ["head_start"]
    assert {label: row["adapters"] for label, row in figures["ablation"].items()} == {
        "none": [], "base_noise": one, "head_start": other,
    }  # fmt: skip


@pytest.mark.parametrize("world", ["analytic", ENGINE])
def test_episode_as_picture_film_and_page(kinfeas, tmp_path, world):
    pytest.importorskip("viser")
    outputs = ("--video", "four.png", "--replay", "page.html", "--picture", "episode.png")
    outputs += ("--json", "out.json")
    outcome = kinfeas(*SHORT, "--world", world, *outputs, "--episode", "0", code=0)
    assert "path_planner" in outcome.out
    assert set(outcome.out.splitlines()[-4:]) == set(outputs[1::2])
    for name in ("four.png", "episode.png"):
        assert (tmp_path / name).read_bytes().startswith(b"\x89PNG")
    assert b"<html" in (tmp_path / "page.html").read_bytes()[:1000].lower()
