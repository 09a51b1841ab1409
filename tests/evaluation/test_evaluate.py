import json
import math
import os
import shutil
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kinfeas.config import PluginSpec
from kinfeas.config.recipes import robot_file
from kinfeas.core import spatial
from kinfeas.core.errors import KinfeasError
from kinfeas.envs import episodes
from kinfeas.envs.episodes import run_episodes, worker_pool
from kinfeas.envs.world import World, WorldConfig, evaluation_world
from kinfeas.evaluation.evaluate import (
    EvalConfig,
    adapter_subsets,
    add_ceiling,
    configure,
    evaluate,
    run,
)
from kinfeas.evaluation.reachability import WAYPOINTS, draw_waypoints
from kinfeas.kinematics.forward import forward
from kinfeas.policies.baselines.following import FollowEe
from kinfeas.policies.loading import load_policy
from kinfeas.robots.loading import load_robot
from kinfeas.tasks.ggr import ggr
from kinfeas.tasks.loading import load_task
from kinfeas.viz.replay import record_episodes


@pytest.fixture(scope="module")
def config(hsr):
    world = replace(evaluation_world(), max_seconds=6.0)
    return EvalConfig(hsr, ggr(distance=(0.5, 0.8)), episodes=20, seed=3, world=world)


@pytest.fixture(scope="module")
def policy(config):
    return load_policy("follow_ee", config.robot)


def test_summary(config, policy):
    ended = []
    summary = evaluate(config, policy, "follow_ee", on_done=ended.append)
    assert summary["ceiling"] is summary["ceiling_low"] is summary["ceiling_high"] is None
    add_ceiling([summary], config)
    assert json.loads(json.dumps(summary)) == summary
    assert (summary["robot"], summary["task"], summary["policy"]) == ("hsr", "ggr", "follow_ee")
    assert (summary["episodes"], summary["seed"]) == (20, 3)
    assert summary["world"] == "analytic"
    assert summary["task_success"] is summary["base_collisions"] is None
    assert summary["success_low"] <= summary["success"] <= summary["success_high"]
    assert summary["success"] <= summary["ceiling"] <= summary["ceiling_high"]
    assert sum(ended) == 20
    failed = summary["failed"]
    assert sum(map(len, failed.values())) == round(20 * (1.0 - summary["success"]))
    assert set(failed) <= {"ik_failure", "collision", "time"}
    table = summary["per_episode"]
    assert {len(column) for column in table.values()} == {20}
    unsolved = [k for k, done in zip(table["episode"], table["success"], strict=True) if not done]
    assert sorted(number for numbers in failed.values() for number in numbers) == unsolved
    assert np.mean(table["mean_deviation"]) == pytest.approx(summary["mean_deviation_m"])


def test_undone_tasks_are_failed_episodes(config, policy, monkeypatch):
    even, zero = np.arange(20) % 2 == 0, np.zeros(20, dtype=np.intp)
    records = replace(run(config, policy)[0], reached=zero == 0, failures=zero, task_done=even)
    monkeypatch.setattr("kinfeas.evaluation.evaluate.run_episodes", lambda *_, **__: records)
    assert evaluate(config, policy)["failed"] == {"task": np.flatnonzero(~even).tolist()}


STUDY = Path(__file__).parents[2] / "docs" / "figures" / "study.json"
PLANNED = ["obstacle_distance", "path_planner", "feasibility"]
LATE = ["path_planner", "time_scaling"]


@pytest.mark.parametrize(("adapters", "settings", "dt", "filters"), [
    (["actuator_lag"], {}, 0.02, LATE), (["base_noise"], {}, 0.02, PLANNED),
    (["actuator_lag"], {"world.dt": 0.1, "world.filters": []}, 0.1, []), ([], {}, 0.1, PLANNED),
    (["command_latency"], {}, 0.02, LATE), ([], {"world.response.base_lag": 0.3}, 0.1, LATE),
])  # fmt: skip
def test_worlds_with_adapters_are_those_of_a_deployment_unless_asked(
    hsr, adapters, settings, dt, filters
):
    settings = {"world.adapters": [{"name": name} for name in adapters], **settings}
    world = configure(hsr, "ggr", settings=settings).world
    assert (world.dt, [each.name for each in world.filters]) == (dt, filters)


@pytest.mark.parametrize(("settings", "filters"), [
    ({}, ["time_scaling"]), ({"world.filters": []}, []),
    ({"world": {"adapters": ["actuator_lag"]}}, LATE), ({"world.response.base_lag": 0.3}, LATE),
])  # fmt: skip
def test_streams_have_the_filters_of_servo_unless_asked(hsr, settings, filters):
    world = configure(hsr, "joystick", settings=settings).world
    assert [each.name for each in world.filters] == filters


def test_an_empty_section_of_deployments_changes_nothing(tmp_path):
    folder = shutil.copytree(robot_file("hsr").parent, tmp_path / "hsr")
    recipes = "analytic: {world: {filters: [feasibility]}}\nsim2real: {world: {}}"
    (folder / "recipes.yaml").write_text(recipes)
    settings = {"world.adapters": ["base_noise"]}
    world = configure(load_robot(folder), "ggr", settings=settings).world
    assert [each.name for each in world.filters] == ["feasibility"]


def test_adapters_of_one_name_are_evaluated_apart_but_no_list_twice():
    one, other, lag = map(PluginSpec, ("base_noise", "base_noise", "actuator_lag"))
    assert adapter_subsets((one, other, lag)) == {
        "none": (), "base_noise 1": (one,), "base_noise 2": (other,), "actuator_lag": (lag,),
        "no base_noise 1": (other, lag), "no actuator_lag": (one, other),
    }  # fmt: skip
    assert list(adapter_subsets((one, lag))) == ["none", "base_noise", "actuator_lag"]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["pr2", "tiago", "hsr"])
def test_packaged_policies_keep_their_success_rate(name):
    cells, robot, episodes = json.loads(STUDY.read_text()), load_robot(name), 60
    # The filters with the highest success are the default.
    rate = max(
        cell["success"]
        for cell in cells
        if (cell["robot"], cell["task"], cell["policy"]) == (name, "ggr", "pretrained")
    )
    records, _ = run(configure(robot, "ggr", episodes=episodes), load_policy("pretrained", robot))
    deviation = math.sqrt(rate * (1.0 - rate) / episodes)
    assert records.success.mean() >= rate - 3.0 * deviation


@pytest.mark.slow
def test_no_figure_depends_on_the_number_of_processes(config, policy, monkeypatch):
    monkeypatch.setattr(episodes, "BATCH", 6)
    ended = []
    assert evaluate(config, policy, processes=2, on_done=ended.append) == evaluate(config, policy)
    assert sum(ended) == config.episodes


@pytest.mark.slow
def test_a_killed_worker_is_an_error():
    with pytest.raises(KinfeasError, match="fewer processes"):  # noqa: SIM117
        with worker_pool(2) as pool:
            pool.submit(os._exit, 1).result()


POOL = """
import time
from kinfeas.envs.episodes import worker_pool
with worker_pool(1) as pool:
    print(pool.submit(int).result(), flush=True)
    pool.submit(time.sleep, 600).result()
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "printed"), [(signal.SIGINT, b"Keyboard"), (signal.SIGKILL, b"")]
)
def test_workers_end_at_once_with_their_parent(number, printed):
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen([sys.executable, "-c", POOL], **pipes) as process:
        assert process.stdout.readline() == b"0\n"
        process.send_signal(number)
        # Ends when no process holds the pipes any more.
        assert printed in process.communicate(timeout=60)[1]


def test_recordings_agree_with_the_records(hsr):
    world = World(hsr, ggr(), WorldConfig(max_failures=99, max_seconds=6.0), seed=4)
    policy = FollowEe(hsr.base)
    recordings = record_episodes(world, policy, 3, first=5)
    records = run_episodes(world, policy, 3, first=5)
    assert [episode.episode for episode in recordings] == [5, 6, 7]
    for row, episode in enumerate(recordings):
        assert episode.base_pose.shape == episode.desired.shape == (len(episode.feasible), 7)
        assert episode.feasible[0]
        assert len(episode.feasible) - 1 == records.steps[row]
        assert int(np.sum(~episode.feasible)) == records.failures[row]
        deviation = np.linalg.norm(episode.ee_pose[1:, :3] - episode.desired[1:, :3], axis=1)
        assert deviation.max() == pytest.approx(records.max_deviation[row], abs=1e-12)
        ee_in_base = forward(world.solver.chain, episode.joint_positions)
        expected = spatial.compose(episode.base_pose, ee_in_base)
        np.testing.assert_allclose(episode.ee_pose, expected, atol=1e-9)


@pytest.mark.parametrize("task", [ggr(), load_task("pick_place")], ids=lambda task: task.name)
def test_waypoints_are_those_of_the_world(hsr, task):
    """Desired poses do not depend on the base; a sub-goal ends where the achieved EE arrives."""
    world = World(hsr, task, WorldConfig(max_failures=10**6), seed=5)
    world.start([0, 1])
    waypoints, desired = draw_waypoints(world.solver, task, 2, 5)[:, :WAYPOINTS], []
    for _ in range(1500):
        world.step(np.zeros((2, world.action_size)))
        desired.append(world.loop.desired)
    for row in range(2):
        missed = waypoints[row][:, np.newaxis] - np.array(desired)[:, row]
        assert np.all(np.abs(missed).max(axis=2).min(axis=1) == 0.0)


CIRCLE = [[0.15 * (np.cos(a) - 1.0), 0.15 * np.sin(a)] for a in np.arange(9) / 4 * np.pi]
DETOUR = [[-0.3, 0.0], [-0.01, 0.0], [-0.3, 0.3], [0.0, 0.0]]


@pytest.mark.parametrize(("generator", "path", "farthest"), [
    ("waypoints", CIRCLE, 0.3), ("waypoints", DETOUR, 0.424), ("replay", CIRCLE, 0.3),
])  # fmt: skip
def test_motions_that_pass_their_end_are_carried_out(hsr, tmp_path, generator, path, farthest):
    prefix = "ee_" if generator == "replay" else ""
    names = [prefix + name for name in ("x", "y", "z", "qx", "qy", "qz", "qw")]
    rows = [f"{5.0 * i},{x},{y},0,0,0,0,1" for i, (x, y) in enumerate(path)]
    (tmp_path / "path.csv").write_text("\n".join([",".join(["time", *names]), *rows]) + "\n")
    (tmp_path / "task.yaml").write_text(
        "name: wipe\nstart: {square: 0.5}\nplaces: {spot: {position: [1.0, 0.0, 0.8]}}\n"
        "subgoals:\n- {place: spot}\n- {place: spot, motion: {generator: "
        f"{generator}, parameters: {{file: path.csv}}}}}}\n"
    )
    config = configure(hsr, str(tmp_path / "task.yaml"), episodes=2)
    policy = load_policy("pretrained", hsr)
    world = World(config.robot, config.task, config.world, config.seed)
    for episode in record_episodes(world, policy, 2):
        goal = np.broadcast_to(episode.goal, episode.desired.shape)
        away = spatial.distance(episode.desired, goal)[0]
        arrival = int(np.argmax(away < 0.03))
        assert episode.reached
        assert away[arrival:].max() == pytest.approx(farthest, abs=0.03)
        assert away[-1] < 0.03
