import shlex
import shutil
from pathlib import Path

import pytest

from kinfeas.config.recipes import default_engine
from kinfeas.robots.loading import load_robot
from tests.builders import contents
from tests.cli.conftest import STUDY, check_one_line, write_demonstrations

ENGINE = default_engine()
SCOUT = Path(__file__).parents[2] / "examples" / "own_robot"
TIAGO = load_robot("tiago").folder
SCENE = "{name: office, size: [4, 4], objects: {desk: {urdf: %s}}}"

INPUT = {
    "": [("fly", "fly"), ("ceiling --robot pr3", "'pr3'")],
    "demo": [("--steps 0", "steps"), ("--out ..", "..")],
    "evaluate": [("", "--policy"), (f"--policy {'x' * 5000}", "File name too long")],
    "evaluate --policy follow_ee --robot hsr --episodes 2": [
        ("--policy follow_me", "'follow_me'"), ("--task gr", "'gr'"), ("--task gr", "YAML"),
        ("--world pybulet", "'pybullet'"), ("--set task.colour=1", "colour"),
        ("--set world", "key=value"), ("--filters feasability", "'feasibility'"),
        ("--adapters adapters.yaml", "base_noise"), ("--gui", "--gui"),
        ("--no-objects", "--no-objects"), ("--episode 2", "episode"),
        ("--json missing/out.json", "missing/out.json"), ("--video film.avi", "film.avi"),
        ("--policy behind", "pip install --no-deps -e behind"),
        (f"--robot lekiwi --task door --world {ENGINE}", "--no-objects"),
    ],
    "train": [
        ("--robot none/robot.yaml", "none/robot.yaml"), ("--task fly", "'fly'"),
        ("--config train_room", "train_rooms"), ("--set learner.lerning_rate=1", "'learning_rate'"),
        ("--minutes 0", "schedule.minutes"), ("--init nowhere", "nowhere"),
        (f"--world {ENGINE} --config train", f"world {ENGINE!r}"), ("--resume nowhere", "nowhere"),
        ("--resume nowhere --seed 1", "--resume"),
    ],
    "reach": [
        ("", "--pose"), ("--pose 1 0 nan 0 0 0", "'poses'"), ("--poses none.csv", "none.csv"),
        ("--pose 1 0 0.8 0 0 0 --scene room --start 9000 9000 0", "m apart"),
        ("--pose 1 0 0.8 0 0 0 --scene rom", "'room'"),
        ("--pose 1 0 0.8 0 0 0 --picture reach.txt", "reach.txt"),
    ],
    "plan --out plan.csv": [
        ("", "--path"), ("--path none.txt", "none.txt"), ("--path plan.csv", "plan.csv"),
        ("--path none.csv --html plan.png", "plan.png"), ("--path linear", "linear"),
        ("--path none.csv --out shown/0.csv", "shown/0.csv"),
    ],
    "benchmark --out out --processes 1 --config study.yaml": [
        ("--config benchmark/none", "study"), (f"--world {ENGINE}", "--world"),
        ("--set episods=3", "'episodes'"), ("--policy pretrained --runs runs", "--runs"),
        ("--runs nowhere", "nowhere"),
    ],
    "export": [
        ("run", "--out FILE"), ("--check none.onnx", "none.onnx"),
        ("follow_ee --out x.onnx", "follow_ee"), ("run --out x.txt", "x.txt"),
        ("run --out x.onnx --robot tiago", "'hsr'"),
    ],
    "deploy pretrained --backend analytic": [
        ("", "goal"), ("--goal 1.5 0.3 --no-real-time", "3 numbers"),
        ("--goal 1.5 0.3 0.8 --rate 5", "guards.max_age"),
        ("--task ggr --set scene=room", "scene"),
    ],
    "deploy pretrained --robot hsr --no-real-time --backend analytic --goal 0.9 0.1 0.8": [
        ("--goal nan 0 0", "finite"), ("--goal 1.5 0 2.2", "guards.reach=false"),
        ("--task door", "'task'"), ("--rpy 0 0 0 --quaternion 0 0 0 1", "'quaternion'"),
        ("--record shown/0.csv", "shown/0.csv"), ("--set guards.sped=1", "guards.sped"),
    ],
    "deploy --goal 0.9 0.1 0.8": [
        (f"{TIAGO / 'policies' / 'pretrained'} --robot pr2", "'tiago'"),
        (f"follow_ee --robot {SCOUT} --backend ros1", "backend.topics"),
    ],
    "simulate --robot hsr": [
        ("--adapters adapters.yaml", "base_noise"), ("--backend analytic", "'analytic'"),
        ("--task door --scene room", "--scene"), ("--scene office.yaml", "'desk'"),
    ],
    "identify": [
        ("", "record"), ("adapters.yaml", "adapters.yaml"), ("run.bag", "'robot'"),
        ("run.bag --robot hsr", "run.bag"),
        ("none.csv --backend analytic", "--drive"), ("none.csv --out fit.txt", "fit.txt"),
        ("none.csv --out adapters.yaml", "adapters.yaml"),
        ("none.csv --robot hsr --prior harhs", "'harsh'"),
    ],
    "identify --drive --robot hsr --no-real-time": [
        ("none.csv", "--drive"), ("--backend analytic --record shown/0.csv", "shown/0.csv"),
    ],
    "view": [
        ("--scene broken.yaml", "tabel.urdf"),
        ("--set 'objects.box.position=[3, 0, 0.5]'", "'box'"), ("--record none.csv", "none.csv"),
        ("--record none.csv --scene room", "'scene'"),
    ],
    "plugins": [
        ("info lienar", "'linear'"), ("info adapters.yaml", "adapters.yaml"),
        ("check linear --set gian=1", "'gian'"), ("new linear", "'linear'"),
        ("check pr2", "'pr2' is a robot"), ("check ggr", "'ggr' is a task"),
    ],
    "fit --out door.yaml": [
        (".", "demonstrations"), ("shown", "shown/0-still.csv"),
    ],
    "robot import scout.urdf --out new": [
        ("--ee plam_link", "'palm_link'"), ("--name a/b", "--name"),
        ("--mesh-path package://scout", "--mesh-path"), ("length=3", "NAME:=VALUE"),
        ("length:=3", "xacro"),
    ],
    "robot import none.urdf --out new": [("", "none.urdf")],
}  # fmt: skip


@pytest.fixture
def files(tmp_path):
    """Good and broken files in the working folder; a function that returns all contents there."""
    texts = {
        "study.yaml": STUDY,
        "adapters.yaml": "adapters: [{name: base_noise, linear: [2, 1]}]",
        "office.yaml": SCENE % "table.urdf",
        "broken.yaml": SCENE % "tabel.urdf",
        "behind/pyproject.toml": "",
    }
    (tmp_path / "behind").mkdir()
    for name, text in texts.items():
        (tmp_path / name).write_text(text)
    shutil.copy(SCOUT / "robot.urdf", tmp_path / "scout.urdf")
    shutil.copytree(load_robot("hsr").folder / "policies" / "pretrained", tmp_path / "run")
    write_demonstrations(tmp_path / "shown", 2)
    write_demonstrations(tmp_path / "shown", 1, moving=False)
    return lambda: contents(tmp_path)


@pytest.mark.parametrize(
    ("line", "named"),
    [(f"{command} {more}", named) for command, rows in INPUT.items() for more, named in rows],
)
def test_bad_input_is_one_line_and_writes_nothing(kinfeas, files, line, named):
    before = files()
    done = kinfeas(*shlex.split(line))
    check_one_line(done, named)
    assert done.out == ""
    assert files() == before


@pytest.mark.parametrize(("line", "named"), [
    ("--host 203.0.113.7", "203.0.113.7"), ("--host no..host", "no..host"),
    ("--backend mujocco", "'mujoco'"), ("follow_me", "'follow_me'"), ("--robot pr3", "'pr3'"),
])  # fmt: skip
def test_pages_end_with_one_line_before_their_address(kinfeas, line, named):
    pytest.importorskip("viser")
    done = kinfeas("play", "--port", "0", *line.split())
    check_one_line(done, named)
    assert done.out == ""


def test_pages_end_with_one_line_if_the_backend_is_no_simulator(kinfeas):
    pytest.importorskip("viser")
    check_one_line(kinfeas("play", "--port", "0", "--backend", "ros2"), "'ros2'")
