import json
from dataclasses import asdict
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

import kinfeas
from kinfeas.api.reach import reach_map
from kinfeas.api.train import configure
from kinfeas.backends.analytic import AnalyticBackend
from kinfeas.core.errors import KinfeasError
from kinfeas.core.solids import Solids
from tests.builders import TRAINING

SHORT = {"world.max_seconds": 1}


def test_train_evaluate_export_and_load(tmp_path):
    reports = []
    settings = TRAINING | {"schedule.minutes": None, "learner.batch_size": np.int64(16)}
    run = kinfeas.train(
        "hsr", steps=64, out=tmp_path / "run", settings=settings, on_progress=reports.append
    )
    assert run.steps == reports[-1].steps >= 64
    assert "minutes: null" in (run.folder / "config.yaml").read_text()
    assert run.metrics == json.loads((run.folder / "evaluation.json").read_text())
    metrics = kinfeas.evaluate(run.folder, episodes=2, settings=SHORT)
    assert (metrics["robot"], metrics["episodes"]) == ("hsr", 2)
    about = kinfeas.export(run.folder, tmp_path / "hsr.onnx")
    assert about.metadata.robot.name == "hsr"
    for policy in (run.folder, tmp_path / "hsr.onnx"):
        loaded = kinfeas.load_policy(policy)
        assert kinfeas.evaluate(loaded, episodes=1, settings=SHORT)["robot"] == "hsr"
    assert max(len(repr(each)) for each in (loaded, loaded.robot, about)) < 200
    with pytest.raises(KinfeasError) as caught:
        kinfeas.train("hsr", out=run.folder)
    assert "--" not in str(caught.value)


def test_a_folder_does_not_hide_an_included_policy(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "pretrained").mkdir()
    metrics = kinfeas.evaluate("pretrained", episodes=1, settings=SHORT)
    assert metrics["policy"] == "pretrained"
    assert metrics["steps"] > 0


def test_a_path_without_slash_is_a_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("mine").symlink_to(kinfeas.load_robot("hsr").folder)
    assert kinfeas.load_robot(Path("mine")).name == "hsr"
    assert configure(Path("mine")).robot == str(tmp_path / "mine")
    options = {"backend": "analytic", "seconds": 0.0, "real_time": False, "record": "a.csv"}
    kinfeas.deploy("follow_ee", robot=Path("mine"), goal=(0.9, 0.1, 0.8), **options)
    assert kinfeas.view(record="a.csv")["robot"] == str(tmp_path / "mine")


def test_policies_are_names_or_objects():
    options = {"episodes": 1, "settings": SHORT}
    policy = kinfeas.load_policy("follow_ee", robot="hsr")
    metrics = kinfeas.evaluate(policy, robot="hsr", **options)
    named = kinfeas.evaluate("follow_ee", robot="hsr", **options)
    assert metrics == named | {"policy": type(policy).__name__}
    for wrong, named in ((policy, "robot"), (object(), "policy")):
        with pytest.raises(KinfeasError, match=named):
            kinfeas.evaluate(wrong, **options)
    for source in ("pretrained", "whole_body_qp"):
        with pytest.raises(KinfeasError, match="'fetch', not for 'tiago'"):
            other = kinfeas.load_policy(source, robot="fetch")
            kinfeas.evaluate(other, robot="tiago", **options)


def test_a_ceiling_is_plain_data():
    options = {"episodes": np.int64(1), "seed": np.int64(1), "settings": {"ik.restarts": 1}}
    bound = kinfeas.ceiling("hsr", path=np.bool_(False), **options)
    assert json.loads(json.dumps(asdict(bound)))["seed"] == 1
    with pytest.raises(KinfeasError, match="'path'"):
        kinfeas.ceiling("hsr", path="no", **options)


def test_adapters_are_entries_of_a_list():
    adapters = ["joint_noise", {"name": "base_noise", "linear": 0.01}]
    metrics = kinfeas.evaluate("follow_ee", adapters=adapters, episodes=1, settings=SHORT)
    assert metrics["adapters"] == ["joint_noise", "base_noise"]


def test_help_lists_all_functions():
    assert all(name in kinfeas.__doc__ for name in kinfeas.__all__[1:])


def test_metrics_are_those_of_the_command(tmp_path, monkeypatch):
    from kinfeas.cli import main

    words = "evaluate --policy follow_ee --robot hsr --adapters ideal --filters feasibility"
    words += f" --episodes 2 --set world.max_seconds=1 --json {tmp_path / 'out.json'}"
    monkeypatch.setattr("sys.argv", ["kinfeas", *words.split()])
    with pytest.raises(SystemExit):
        main.main()
    metrics = kinfeas.evaluate(
        "follow_ee",
        robot="hsr",
        adapters=Path("ideal"),
        episodes=2,
        filters=["feasibility"],
        settings={"world": {"max_seconds": 1}},
    )
    assert metrics == json.loads((tmp_path / "out.json").read_text())
    assert metrics["settings"]["world"]["max_seconds"] == 1
    assert (metrics["version"], metrics["steps"]) == (kinfeas.__version__, None)
    assert np.isfinite(metrics["mean_deviation_m"])
    bound = kinfeas.ceiling("hsr", episodes=2)
    assert bound.ceiling == metrics["ceiling"] == bound.convergence[-1]


class Targets:
    """A source of targets within a program."""

    def start(self, controller):
        self.controller = controller

    def close(self):
        self.closed = True


def test_a_servo_and_a_deployment_in_a_program(tmp_path):
    source, options = Targets(), {"robot": "hsr", "backend": "analytic", "seconds": 0.3}
    relaxed = {"guards": {"max_age": 5.0, "max_period": 5.0, "max_clock_skew": 5.0}}
    run = kinfeas.servo(source=source, record=tmp_path / "a.csv", settings=relaxed, **options)
    assert (run.outcome.code, source.closed, run.targets["messages"]["accepted"]) == (4, True, 0)
    assert run.outcome.reason == "no message was accepted: none came"
    moments = []
    run = kinfeas.deploy(
        "stationary", goal=(0.9, 0.1, 0.8), real_time=False, record=tmp_path / "b.csv",
        on_moment=moments.append, filters="none", **options,
    )  # fmt: skip
    assert (run.outcome.code, run.about.robot, len(moments)) == (4, "hsr", 17)
    assert kinfeas.view(record=run.record)["steps"] == 15
    settings = {"response.base_lag": 0.3}
    late = [
        kinfeas.deploy(
            "stationary", goal=(0.9, 0.1, 0.8), real_time=False, record=tmp_path / f"{name}.csv",
            **{**options, "seconds": 0.02, name: value},
        ).about.filters
        for name, value in (("settings", settings), ("adapters", ["actuator_lag"]))
    ]  # fmt: skip
    assert late[0] == late[1]
    run = kinfeas.deploy(
        "pretrained", goal=(0.9, 0.1, 0.8), real_time=False, record=tmp_path / "c.csv",
        on_moment=Mock(side_effect=RuntimeError("no ear")), **options,
    )  # fmt: skip
    assert (run.outcome.code, run.outcome.reason.split()[0]) == (3, "on_moment")
    assert kinfeas.view(record=run.record)["events"][-1]["event"] == run.outcome.reason


def test_a_servo_without_a_source_closes_its_backend(tmp_path, monkeypatch):
    closed, broken = Mock(), Mock(start=Mock(side_effect=KeyError("no sight")))
    monkeypatch.setattr(AnalyticBackend, "close", closed)
    options = {"backend": "analytic", "record": tmp_path / "a.csv"}
    for key in ("source", "task"):
        with pytest.raises(KinfeasError, match=f"'{key}'"):
            kinfeas.servo(source=Targets(), settings={f"{key}.port": 3}, **options)
    with pytest.raises(KeyError):
        kinfeas.servo(source=broken, **options)
    assert closed.called
    assert broken.close.called


@pytest.mark.parametrize("arguments", [
    {"policy": "folow_ee"}, {"policy": object()}, {"robot": object()}, {"world": "real"},
    {"episodes": np.int64(0)}, {"episodes": (3,)}, {"episodes": object()},
    {"seed": np.int64(-1)}, {"processes": 0}, {"filters": 3}, {"adapters": [3]},
    {"settings": {"world.dtt": 1}}, {"settings": {"world.dt": object()}},
    {"settings": {"world.dt": np.zeros(2)}}, {"settings": {5: 1}}, {"settings": 5},
    {"episode": 0.5}, {"picture": "no_folder/a.png"}, {"video": "a.avi"}, {"replay": 3},
])  # fmt: skip
def test_bad_input_is_an_error_before_the_first_episode(arguments):
    progress = Mock()
    with pytest.raises(KinfeasError):
        kinfeas.evaluate(**{"policy": "follow_ee", "on_progress": progress, **arguments})
    assert not any(call.args[1] for call in progress.call_args_list)


@pytest.mark.parametrize("function", [kinfeas.export, kinfeas.identify])
def test_files_to_write_are_paths(function):
    with pytest.raises(KinfeasError, match="'out'"):
        function("pretrained", out=3)


@pytest.mark.parametrize("arguments", [{"record": 3}, {"picture": 3}, {"video": "a.gif"}])
def test_bad_arguments_of_view_are_errors(arguments):
    with pytest.raises(KinfeasError, match=f"'{next(iter(arguments))}'"):
        kinfeas.view(**arguments)


@pytest.mark.parametrize("arguments", [{"components": 51}, {"kind": "spline"}, {"seed": -1}])
def test_bad_arguments_of_fit_are_errors(tmp_path, arguments):
    with pytest.raises(KinfeasError, match=next(iter(arguments))):
        kinfeas.fit(tmp_path, tmp_path / "model.yaml", **arguments)


@pytest.mark.parametrize(
    ("option", "named"), [("stepz", "'steps'"), ("num_envs", r'settings=\{"num_envs": 8\}')]
)
def test_unknown_options_of_a_training_are_errors(option, named):
    with pytest.raises(KinfeasError, match=named):
        kinfeas.train("hsr", **{option: 8})


@pytest.mark.parametrize("arguments", [
    {"k": (3,)}, {"start": 3.0}, {"start": (0.0, 0.0)}, {"together": "no"}, {"poses": []},
    {"poses": None}, {"solids": [[1.0, 2.0]]}, {"start": (3.0, 0.0, 0.0), "scene": "room"},
    {"solids": Solids.empty(0)}, {"solids": Solids.empty(2, 1)},
])  # fmt: skip
def test_bad_arguments_of_reach_are_errors(arguments):
    pose = [2.0, 1.0, 0.8, 0.0, 0.0, 0.0, 1.0]
    with pytest.raises(KinfeasError, match=f"'{next(iter(arguments))}'"):
        kinfeas.reach("hsr", **{"poses": [pose], **arguments})
    if "scene" in arguments:
        with pytest.raises(KinfeasError, match="'start'"):
            reach_map("hsr", pose, **arguments)


def test_reach_takes_files_and_tables_of_solids(tmp_path):
    (tmp_path / "ee.csv").write_text("x,y,z,qx,qy,qz,qw\n2,1,0.8,0,0,0,1\n2,0,0.8,0,0,0,1\n")
    table = [[2.0, 1.0, 0.0, 0.2, 0.2, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0]]
    first, second = kinfeas.reach("hsr", tmp_path / "ee.csv", scene="room", solids=table)
    assert first.solids == ("solid 0",) and len(second.base_pose)


@pytest.mark.parametrize(("x", "blocked"), [(2.6, False), (2.8, True)])
def test_reach_avoids_movable_objects_except_those_in_the_hand(x, blocked):
    (answer,) = kinfeas.reach("pr2", [[x - 0.1, 0.0, 0.66, 0, 0, 0, 1]], scene="room")
    assert ("box" in answer.solids) == blocked == (not len(answer.base_pose))


def test_objects_in_the_hand_at_one_pose_are_in_the_way_of_others():
    poses = [[2.5, 0.0, 0.66, 0, 0, 0, 1], [2.7, 0.0, 0.66, 0, 0, 0, 1]]
    grasped, beyond = kinfeas.reach("pr2", poses, scene="room")
    assert grasped.reachable
    assert beyond.solids == ("box",)
    (both,) = kinfeas.reach("pr2", poses, scene="room", together=True)
    assert both.reachable


@pytest.mark.parametrize("arguments", [
    {"goal": (0.9, 0.1)}, {"goal": "abc"}, {"goal": 3}, {"quaternion": np.array([0.0, 0.0, 1.0])},
    {"seconds": -1.0}, {"seconds": np.nan}, {"rate": 0.0}, {"rate": (50.0,)}, {"task": "ggr"},
    {"backend": "ros2", "real_time": False}, {"record": 3}, {"guards": 3},
])  # fmt: skip
def test_bad_deployments_are_errors(tmp_path, arguments):
    options = {"policy": "follow_ee", "backend": "analytic", "goal": np.array([0.9, 0.1, 0.8])}
    with pytest.raises(KinfeasError):
        kinfeas.deploy(**options | {"record": tmp_path / "a.csv"} | arguments)


@pytest.mark.parametrize("run", [kinfeas.deploy, kinfeas.servo])
def test_a_robot_is_no_rehearsal(tmp_path, run):
    options = {"goal": (0.9, 0.1, 0.8)} if run is kinfeas.deploy else {}
    with pytest.raises(KinfeasError, match="response"):
        run("follow_ee", backend="ros2", adapters="harsh", record=tmp_path / "a.csv", **options)
