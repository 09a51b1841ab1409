import shutil
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import pytest
from annotated_types import Interval
from hypothesis import given
from hypothesis import strategies as st

from kinfeas.config import PluginSpec, dump, from_mapping, load
from kinfeas.config.recipes import load_section, section
from kinfeas.core.errors import KinfeasError
from kinfeas.evaluation.evaluate import EvalSettings
from kinfeas.policies.baselines.following import BaselineConfig
from kinfeas.robots.loading import load_robot
from kinfeas.sim2real.deploy.config import DeployConfig
from kinfeas.training.config import TrainConfig, load_recipe


@dataclass(frozen=True)
class Noise:
    base: Annotated[float, Interval(ge=0.0, le=1.0)] = 0.0
    lag: int = 0

    def __post_init__(self):
        if self.lag > 100:
            raise ValueError("'lag' is too large")


@dataclass(frozen=True)
class Recipe:
    robot: str
    steps: Annotated[int, Interval(ge=1)] = 1000
    rate: Annotated[float, Interval(gt=0.0)] = 1e-3
    flag: bool = False
    algorithm: Literal["sac", "td3"] = "sac"
    layers: tuple[int, ...] = (256, 256)
    window: tuple[float, float] | None = None
    either: float | tuple[float, float] = 0.0
    out: Path = Path("runs")
    parameters: dict[str, object] = field(default_factory=dict)
    noise: Noise = Noise(base=0.5, lag=3)
    extra: Noise | None = None
    many: dict[str, Noise] = field(default_factory=dict)
    stages: tuple[Noise, ...] = ()
    adapters: tuple[PluginSpec, ...] = ()


FLOATS = st.floats(allow_nan=False, allow_infinity=False)
WORDS = st.text("ab1.- #:é", min_size=1)
RECIPES = st.builds(
    Recipe,
    robot=st.text(),
    steps=st.integers(1, 10**20),
    rate=st.floats(1e-300, 1e300),
    flag=st.booleans(),
    algorithm=st.sampled_from(["sac", "td3"]),
    layers=st.lists(st.integers()).map(tuple),
    window=st.none() | st.tuples(FLOATS, FLOATS),
    either=FLOATS | st.tuples(FLOATS, FLOATS),
    out=st.lists(st.text("ab1.-", min_size=1), min_size=1).map(lambda parts: Path(*parts)),
    parameters=st.dictionaries(st.text(), st.lists(FLOATS | st.text()) | st.booleans()),
    noise=st.builds(Noise, st.floats(0.0, 1.0), st.integers(-5, 100)),
    extra=st.none() | st.just(Noise()),
    adapters=st.lists(
        st.builds(PluginSpec, WORDS, st.dictionaries(WORDS, FLOATS | WORDS)), max_size=2
    ).map(tuple),
)


@given(RECIPES)
def test_file_and_back_is_the_identity(tmp_path_factory, recipe):
    path = tmp_path_factory.mktemp("config") / "recipe.yaml"
    dump(recipe, path)
    assert load(Recipe, path) == recipe


@pytest.mark.parametrize(("settings", "changed"), [
    ({"rate": 1e-5}, {"rate": 1e-5}),
    ({"layers.1": 8}, {"layers": (256, 8)}),
    ({"out": "a=b"}, {"out": Path("a=b")}),
    ({"parameters.a.b": "x"}, {"parameters": {"c": 1, "a": {"b": "x"}}}),
    ({"parameters": {"a": 2}}, {"parameters": {"c": 1, "a": 2}}),
    ({"parameters": {}}, {"parameters": {}}),
    ({"noise.base": 1}, {"noise": Noise(base=1.0, lag=2)}),
    ({"noise": {"base": np.float64(1)}, "noise.lag": 4}, {"noise": Noise(base=1.0, lag=4)}),
    ({"extra.lag": 1}, {"extra": Noise(lag=1)}),
    ({"stages.0.lag": 5}, {"stages": (Noise(base=1.0, lag=5),)}),
    ({"either": [1, 2]}, {"either": (1.0, 2.0)}),
    ({"many": {"a": {}, "b": {"lag": 1}}}, {"many": {"a": Noise(), "b": Noise(lag=1)}}),
    ({"adapters": ["fog", {"name": "clamp", "by": 2}]},
     {"adapters": (PluginSpec("fog"), PluginSpec("clamp", {"by": 2}))}),
    ({"adapters.0.by": 3}, {"adapters": (PluginSpec("clamp", {"by": 3}),)}),
    ({"adapters": [PluginSpec("fog")]}, {"adapters": (PluginSpec("fog"),)}),
])  # fmt: skip
def test_settings_win_over_the_file(tmp_path, settings, changed):
    path = tmp_path / "recipe.yaml"
    path.write_text(
        "{robot: pr2, layers: [256, 16], stages: [{lag: 1, base: 1}], noise: {lag: 2}, "
        "adapters: [{name: clamp, by: 2}], parameters: {c: 1}}"
    )
    assert load(Recipe, path, settings) == replace(load(Recipe, path), **changed)


@pytest.mark.parametrize("wrong", [-2, False, "", [], np.zeros(2)])
@pytest.mark.parametrize("key", ["stps", "noise.base", "rate.x", "layers.2", "steps", "extra"])
def test_wrong_settings_are_named_without_the_file(key, wrong):
    data, changes = {"robot": "pr2", "layers": [1]}, {"flag": True, key: wrong}
    with pytest.raises(KinfeasError, match=r"^settings: ") as caught:
        from_mapping(Recipe, data, "file.yaml", changes)
    assert key.partition(".")[0] in str(caught.value) or "'2'" in str(caught.value)
    with pytest.raises(KinfeasError, match=r"^file.yaml: 'robot': "):
        from_mapping(Recipe, {}, "file.yaml", {"flag": True})


@pytest.mark.parametrize(("key", "value", "rule"), [
    ("window", [1.0], "'window': must be a list of 2 "), ("noise", {"lag": 200}, "'noise': 'lag'"),
    ("either", float("nan"), "'either': .* number or .* array,"), ("steps", 0, "'steps': Input"),
])  # fmt: skip
def test_errors_name_the_key_and_its_rule(key, value, rule):
    with pytest.raises(KinfeasError, match=f"^file.yaml: {rule}"):
        from_mapping(Recipe, {"robot": "pr2", key: value}, "file.yaml")


SCHEMAS = {
    **dict.fromkeys(("train", "train_physics", "train_rooms", "finetune_physics"), TrainConfig),
    **dict.fromkeys(("analytic", "pybullet"), EvalSettings),
    **{"deploy": DeployConfig, "baselines": BaselineConfig},
}


@pytest.mark.parametrize("name", SCHEMAS)
@pytest.mark.parametrize("robot", ["pr2", "tiago", "hsr"])
def test_shipped_sections_are_valid(name, robot):
    assert load_section(SCHEMAS[name], name, robot)


def test_keys_that_a_recipe_lacks_are_those_of_its_robot(tmp_path):
    robot, path = "tiago", tmp_path / "mine.yaml"
    path.write_text("learner: {gamma: 0.9}\nseed: 3\n")
    own = load_recipe(None, {"robot": robot})
    mine = replace(own, seed=3, learner=replace(own.learner, gamma=0.9))
    assert load_recipe(str(path), {"robot": robot}) == mine
    assert load_recipe(str(path), robot=robot) == mine
    path.write_text(path.read_text() + f"robot: {robot}\n")
    assert load_recipe(str(path)) == mine
    assert own == replace(load_section(TrainConfig, "train", robot), robot=robot)
    physics = load_recipe(None, {"robot": robot}, backend="mujoco")
    learner = replace(physics.learner, gamma=0.9)
    assert load_recipe(str(path), backend="mujoco") == replace(physics, seed=3, learner=learner)
    assert (physics.world.backend, physics.processes) == ("mujoco", 1)


def test_recipes_extend_others_by_name_and_by_path_relative_to_the_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "below").mkdir()
    (tmp_path / "base.yaml").write_text("extends: train_rooms\nnum_envs: 5\n")
    top = tmp_path / "below" / "top.yaml"
    top.write_text("extends: ../base.yaml\nrobot: hsr\n")
    rooms = load_section(TrainConfig, "train_rooms", "hsr")
    assert load_recipe("below/top.yaml") == replace(rooms, robot="hsr", num_envs=5)
    top.write_text("extends: paper/pr2\nseed: 2\n")
    assert load_recipe("below/top.yaml") == replace(load_recipe("paper/pr2"), seed=2)


@pytest.mark.parametrize(("text", "named"), [
    ("extends: paper/pr3", "extends: .*paper/pr2.*train_rooms"), ("extends: 3", "'extends'"),
    ("extends: mine.yaml", "mine.yaml: 'extends'"), ("extends: sub", "'sub'"),
    ("robot: 3", "'robot'"), ("robot: hsr\nlerner: {}", "'learner'"), ("robot: pr3", "'pr3'"),
])  # fmt: skip
def test_wrong_recipes_name_the_file_or_the_value(tmp_path, text, named):
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    with pytest.raises(KinfeasError, match=named) as caught:
        load_recipe(str(path))
    assert "\n" not in str(caught.value)


def test_only_the_folder_of_a_robot_has_its_recipes(tmp_path):
    pr2 = load_robot("pr2").folder
    for name in ("robot.yaml", "robot.urdf"):
        shutil.copy(pr2 / name, tmp_path)
    assert load_robot(tmp_path).name == "pr2"
    assert section("physics", tmp_path)[0] == section("physics")[0] != section("physics", pr2)[0]
    (tmp_path / "recipes.yaml").write_text("physics: {world: {time_scale: 0.25}}")
    for path in (tmp_path, tmp_path / "robot.yaml"):
        assert section("physics", path)[0]["world"]["time_scale"] == 0.25
    (tmp_path / "recipes.yaml").write_text("deploy:\n")
    assert section("deploy", tmp_path)[0] == section("deploy")[0]
    (tmp_path / "recipes.yaml").write_text("phisics: {}")
    with pytest.raises(KinfeasError, match=rf"{tmp_path}.*'phisics'.*'physics'"):
        section("physics", tmp_path)
