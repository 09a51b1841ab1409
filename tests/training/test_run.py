import json
import shutil

import pytest

from kinfeas import config
from kinfeas.config.recipes import recipes
from kinfeas.core.errors import KinfeasError
from kinfeas.envs.world import World
from kinfeas.robots.loading import load_robot
from kinfeas.tasks.loading import load_task
from kinfeas.training.config import TrainConfig, load_recipe
from kinfeas.training.run import (
    Progress,
    check_begun,
    check_run_folder,
    content_hashes,
    finished,
    fraction_done,
    read_progress,
)


@pytest.mark.parametrize("name", ["new", "new/below", "empty", "half"])
def test_a_run_begins_in_an_empty_folder(tmp_path, name):
    (tmp_path / "empty").mkdir()
    (tmp_path / "half" / ".half").mkdir(parents=True)
    check_run_folder(tmp_path / name)
    assert not (tmp_path / "new").exists()


def test_a_run_is_not_written_over_and_suggests_to_resume_it(tmp_path):
    for folder, file in (("others", "notes.txt"), ("my run", "config.yaml")):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / file).touch()
    with pytest.raises(KinfeasError, match="resume it"):
        check_run_folder(tmp_path / "my run")
    (tmp_path / "file").touch()
    for name in ("others", "file", "file/run", "n" * 300):
        with pytest.raises(KinfeasError, match=name):
            check_run_folder(tmp_path / name)
    check_begun(tmp_path / "my run")
    for name in ("others", "nothing", "n" * 300):
        with pytest.raises(KinfeasError, match=name):
            check_begun(tmp_path / name)


@pytest.mark.parametrize(("schedule", "share"), [
    ({"steps": 2000, "minutes": None}, 0.2),
    ({"steps": None, "minutes": 2}, 0.25),
    ({"steps": 2000, "minutes": 2}, 0.25),
    ({"steps": 2000, "minutes": 20}, 0.2),
    ({"steps": 300, "minutes": 20}, 1.0),
])  # fmt: skip
def test_steps_or_time_end_a_run_whichever_comes_first(tiny, schedule, share):
    assert fraction_done(tiny({"schedule": schedule}), Progress(400, 30.0)) == share


def edit(path, keys, value):
    """Change an entry of a JSON file."""
    data = entries = json.loads(path.read_text())
    for key in keys[:-1]:
        entries = entries[key]
    entries[keys[-1]] = value
    path.write_text(json.dumps(data))


@pytest.fixture
def ended(whole, tmp_path):
    """A copy of the checkpoints and settings of a finished run."""
    shutil.copytree(whole, tmp_path / "run")
    assert finished(tmp_path / "run")
    return tmp_path / "run"


@pytest.mark.parametrize(("file", "keys", "value"), [
    ("last/state.json", ("progress", "steps"), 312),
    ("last/state.json", ("progress", "evaluations"), 1),
    ("best/policy.json", ("fresh_evaluation",), {}),
])  # fmt: skip
def test_a_run_with_something_left_to_do_is_not(ended, file, keys, value):
    edit(ended / "checkpoints" / file, keys, value)
    assert finished(ended) is None


@pytest.mark.parametrize(
    ("key", "value"), [("steps", -8), ("seconds", float("nan")), ("best", 2.0), ("recent", [0.5])]
)
def test_wrong_progress_raises(ended, key, value):
    edit(ended / "checkpoints/last/state.json", ("progress", key), value)
    with pytest.raises(KinfeasError, match=rf"state\.json: .*'{key}[.0]*'"):
        finished(ended)


@pytest.mark.parametrize(
    ("settings", "key"),
    [
        ({"seed": 3}, "seed"),
        ({"num_envs": 4}, "num_envs"),
        ({"learner.gamma": 0.9}, "learner.gamma"),
    ],
)
def test_a_checkpoint_of_other_settings_raises(whole, tiny, settings, key):
    last = whole / "checkpoints" / "last"
    with pytest.raises(KinfeasError, match=f"{last}: .* its {key} is"):
        read_progress(tiny(settings), last)


def test_a_run_that_is_longer_already_raises(ended):
    with pytest.raises(KinfeasError, match=f"{ended}: has 320 steps"):
        finished(ended, {"schedule.steps": 100})


def test_a_robot_may_move_but_not_change(hsr, ended, tmp_path):
    shutil.copytree(hsr.folder, tmp_path / "mine")
    assert finished(ended, {"robot": str(tmp_path / "mine")})
    with pytest.raises(KinfeasError, match=f"{tmp_path}/none .* --robot"):
        finished(ended, {"robot": str(tmp_path / "none")})
    path = tmp_path / "mine" / "robot.yaml"
    path.write_text(path.read_text().replace("max_velocity:", "max_velocity: 0.1 #"))
    with pytest.raises(KinfeasError, match=f"another robot, or {tmp_path}/mine has changed"):
        finished(ended, {"robot": str(tmp_path / "mine")})


def test_a_task_may_move_with_its_files_but_not_change(tiny, tmp_path):
    def hashes(name, x=2.0, size=9):
        folder = tmp_path / name
        folder.mkdir()
        (folder / "own.yaml").write_text(f"name: own\nsize: [9, {size}]\nobjects: {{}}\n")
        task = {"name": "own", "scene": {"name": "own.yaml"}, "subgoals": [{"place": "shelf"}]}
        task["places"] = {"shelf": {"position": [x, 0.0, 1.0]}}
        (folder / "task.yaml").write_text(json.dumps(task))
        return content_hashes(tiny({"task": str(folder / "task.yaml")}))

    first = hashes("first")
    assert hashes("moved") == first
    assert hashes("changed", 2.5)["task"] != first["task"]
    assert hashes("room", size=8)["task"] != first["task"]


@pytest.mark.parametrize(("name", "robot"), [
    *((name, robot) for name in ("train", "train_rooms") for robot in ("pr2", "tiago", "hsr")),
    *((name, "pr2") for name in recipes("paper")),
])  # fmt: skip
def test_every_recipe_makes_a_world(name, robot):
    recipe = load_recipe(name, robot=robot)
    task = load_task(recipe.task, recipe.task_parameters)
    World(load_robot(recipe.robot), task, recipe.world, recipe.seed)
    assert config.from_mapping(TrainConfig, config.to_mapping(recipe), "again") == recipe


@pytest.mark.parametrize(
    ("key", "value"),
    [("learner.schedule", "cosine"), ("learner.gamma", 1.5), ("schedule.steps", None),
     ("processes", 9)],
)  # fmt: skip
def test_values_out_of_range_raise(tiny, key, value):
    with pytest.raises(KinfeasError, match=key.split(".")[-1]):
        tiny({key: value})
