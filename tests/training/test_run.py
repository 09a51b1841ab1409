import json

import pytest

from kinfeas import config
from kinfeas.config.recipes import recipes
from kinfeas.core.errors import KinfeasError
from kinfeas.envs.world import World
from kinfeas.io.policy_metadata import Trained, write_trained
from kinfeas.robots.loading import load_robot
from kinfeas.tasks.loading import load_task
from kinfeas.training.config import TrainConfig, load_recipe
from kinfeas.training.run import (
    Progress,
    check_begun,
    check_new,
    finished,
    fraction_done,
    identity,
    read_progress,
    read_state,
    write_state,
)


@pytest.mark.parametrize("name", ["new", "new/below", "empty", "half"])
def test_a_run_begins_in_an_empty_folder(tmp_path, name):
    (tmp_path / "empty").mkdir()
    (tmp_path / "half" / ".half").mkdir(parents=True)
    before = sorted(tmp_path.rglob("*"))
    check_new(tmp_path / name)
    assert sorted(tmp_path.rglob("*")) == before


def test_a_run_is_not_written_over_and_suggests_to_resume_it(tmp_path):
    for folder, file in (("others", "notes.txt"), ("my run", "config.yaml")):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / file).touch()
    with pytest.raises(KinfeasError, match="resume it"):
        check_new(tmp_path / "my run")
    (tmp_path / "file").touch()
    for name in ("others", "file", "file/run", "n" * 300):
        with pytest.raises(KinfeasError, match=name):
            check_new(tmp_path / name)
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


@pytest.fixture
def write_run(tiny, tmp_path):
    """A function that writes the files of a run and returns its settings and last checkpoint."""
    best, last = tmp_path / "checkpoints" / "best", tmp_path / "checkpoints" / "last"

    def write(steps=320, evaluations=2, fresh=True):
        settings = tiny()
        progress = Progress(steps, 9.0, evaluations=evaluations)
        for folder in (best, last):
            folder.mkdir(parents=True)
        config.dump(settings, tmp_path / "config.yaml")
        write_state(last, {"config": identity(settings), "progress": progress.saved()})
        figures = {"success": 0.5} if fresh else {}
        terms = {"observation": (), "action": ()}
        write_trained(Trained(robot="hsr", layers=3, fresh_evaluation=figures, **terms), best)
        return settings, last

    return write


@pytest.mark.parametrize("left", [{"steps": 312}, {"evaluations": 1}, {"fresh": False}])
def test_a_run_with_something_left_to_do_is_not(write_run, tmp_path, left):
    write_run(**left)
    assert finished(tmp_path) is None


@pytest.mark.parametrize(
    ("settings", "key"),
    [({"seed": 3}, "seed"), ({"num_envs": 4}, "num_envs"), ({"learner.gamma": 0.9}, "learner")],
)
def test_a_checkpoint_of_other_settings_raises(write_run, tiny, settings, key):
    _, last = write_run()
    with pytest.raises(KinfeasError, match=f"{last}: .* its {key} is"):
        read_progress(tiny(settings), last)


@pytest.mark.parametrize(
    ("key", "value"), [("steps", -8), ("seconds", float("nan")), ("best", 2.0), ("recent", [0.5])]
)
def test_wrong_progress_raises(write_run, tmp_path, key, value):
    _, last = write_run()
    state = read_state(last)
    state["progress"][key] = value
    (last / "state.json").write_text(json.dumps(state))
    with pytest.raises(KinfeasError, match=rf"state\.json: .*'{key}[.0]*'"):
        finished(tmp_path)


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
