from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinfeas.config import Interval, assigned, dump, from_mapping, load, to_mapping
from kinfeas.core.errors import KinfeasError


@dataclass(frozen=True)
class Motion:
    name: str = "linear"
    parameters: dict[str, object] = field(default_factory=lambda: {"speed": 0.1})


@dataclass(frozen=True)
class Noise:
    base: Annotated[float, Interval(0.0, 1.0)] = 0.0
    lag: int = 0


@dataclass(frozen=True)
class Recipe:
    robot: str
    steps: Annotated[int, Interval(low=1)] = 1000
    rate: float = 1e-3
    algorithm: Literal["sac", "td3"] = "sac"
    layers: tuple[int, ...] = (256, 256)
    window: tuple[float, float] | None = None
    out: Path = Path("runs")
    motion: Motion = Motion()
    noise: Noise = Noise(base=0.5, lag=3)
    extra: Noise | None = None
    stages: tuple[Noise, ...] = ()


FLOATS = st.floats(allow_nan=False, allow_infinity=False)
RECIPES = st.builds(
    Recipe,
    robot=st.text(),
    steps=st.integers(1, 10**20),
    rate=FLOATS,
    algorithm=st.sampled_from(["sac", "td3"]),
    layers=st.lists(st.integers()).map(tuple),
    window=st.none() | st.tuples(FLOATS, FLOATS),
    out=st.lists(st.text("ab1.-", min_size=1), min_size=1).map(lambda parts: Path(*parts)),
    motion=st.builds(
        Motion, st.text(), st.dictionaries(st.text(), st.lists(FLOATS | st.text()) | st.booleans())
    ),
    noise=st.builds(Noise, st.floats(0.0, 1.0), st.integers()),
    extra=st.none() | st.builds(Noise),
)


@given(RECIPES)
def test_file_and_back_is_the_identity(tmp_path_factory, recipe):
    path = tmp_path_factory.mktemp("config") / "recipe.yaml"
    dump(recipe, path)
    assert load(Recipe, path) == recipe


@given(RECIPES)
def test_mapping_and_back_is_the_identity(recipe):
    assert from_mapping(Recipe, to_mapping(recipe), "x") == recipe


def test_to_mapping_is_plain():
    recipe = Recipe("pr2", rate=np.float64(0.5), window=(0.0, 1.0))
    mapping = to_mapping(recipe)
    assert mapping["layers"] == [256, 256]
    assert mapping["out"] == "runs"
    assert mapping["noise"] == {"base": 0.5, "lag": 3}
    assert type(mapping["rate"]) is float


@pytest.mark.parametrize("value", [3, {"a": 1}, Recipe])
def test_to_mapping_takes_dataclasses_only(value):
    with pytest.raises(TypeError, match="no instance of a dataclass"):
        to_mapping(value)


def write(folder, text):
    path = folder / "recipe.yaml"
    path.write_text(text)
    return path


def test_load(tmp_path):
    path = write(tmp_path, "robot: pr2\nrate: 3e-4\nnoise: {base: 1}\nlayers: [64]\n")
    assert load(Recipe, path) == Recipe("pr2", rate=3e-4, noise=Noise(base=1.0), layers=(64,))


def test_load_names_the_file(tmp_path):
    path = write(tmp_path, "robot: pr2\nnoise: {bse: 1}\n")
    with pytest.raises(KinfeasError) as caught:
        load(Recipe, path)
    assert str(caught.value) == (
        f"{path}: unknown key 'noise.bse' (did you mean 'base'?); known are base, lag"
    )


@pytest.mark.parametrize(
    ("override", "changed"),
    [
        ("robot=hsr", {"robot": "hsr"}),
        ("steps = 5", {"steps": 5}),
        ("rate=1e-5", {"rate": 1e-5}),
        ("layers=[8, 8]", {"layers": (8, 8)}),
        ("layers.1=8", {"layers": (256, 8)}),
        ("window.0=-1", {"window": (-1.0, 1.0)}),
        ("window=null", {"window": None}),
        ("out=a=b", {"out": Path("a=b")}),
        # A block that the file leaves out keeps its other defaults.
        ("noise.base=1", {"noise": Noise(base=1.0, lag=3)}),
        ("motion.parameters.gain=2", {"motion": Motion(parameters={"speed": 0.1, "gain": 2})}),
        ("motion.parameters.a.b=x", {"motion": Motion(parameters={"speed": 0.1, "a": {"b": "x"}})}),
        ("extra.lag=1", {"extra": Noise(lag=1)}),
        ("noise={lag: 1}", {"noise": Noise(lag=1)}),
    ],
)
def test_override_wins(tmp_path, override, changed):
    path = write(tmp_path, "robot: pr2\nwindow: [0, 1]\n")
    expected = {"robot": "pr2", "window": (0.0, 1.0), **changed}
    assert load(Recipe, path, [override]) == Recipe(**expected)


def test_assignments_alone_are_nested_mappings():
    assert assigned(["a.b=1", "a.c=[x]", "d=null"]) == {"a": {"b": 1, "c": ["x"]}, "d": None}
    with pytest.raises(KinfeasError, match=r"--set gain: must be of the form key=value or"):
        assigned(["gain"])
    with pytest.raises(
        KinfeasError, match=r"--set a\.b=2: unknown key 'a\.b', for 'a' has no keys"
    ):
        assigned(["a=1", "a.b=2"])


def test_override_keeps_the_rest_of_the_files_block(tmp_path):
    path = write(tmp_path, "robot: pr2\nnoise: {lag: 9}\n")
    assert load(Recipe, path, ["noise.base=1"]).noise == Noise(base=1.0, lag=9)


def test_override_changes_one_entry_of_the_files_list(tmp_path):
    path = write(tmp_path, "robot: pr2\nstages: [{lag: 1, base: 1}, {lag: 2}]\n")
    found = load(Recipe, path, ["stages.0.lag=5", "stages.1={base: 0.5}"]).stages
    assert found == (Noise(base=1.0, lag=5), Noise(base=0.5))


def test_last_override_wins_and_data_stays_as_it_was():
    data = {"robot": "pr2", "noise": {"lag": 1}}
    recipe = from_mapping(Recipe, data, "x", ["noise.lag=2", "noise.lag=3", "noise.base=1"])
    assert recipe.noise == Noise(base=1.0, lag=3)
    assert data == {"robot": "pr2", "noise": {"lag": 1}}


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("stps=1", "unknown key 'stps' (did you mean 'steps'?)"),
        ("noise.x=1", "unknown key 'noise.x'; known are base, lag"),
        ("noise.base=2", "'noise.base' must be a number in [0, 1], not 2"),
        ("noise=2", "'noise' must be a mapping of keys to values, not 2"),
        ("rate.x=2", "unknown key 'rate.x', for 'rate' has no keys"),
        ("layers.2=2", "unknown key 'layers.2'; known are 0 to 1"),
        ("layers.x=2", "unknown key 'layers.x'; known are 0 to 1"),
        ("stages.0.lag=2", "unknown key 'stages.0'; known are none"),
        ("layers.0.x=2", "unknown key 'layers.0.x', for 'layers.0' has no keys"),
        ("layers.0=x", "'layers.0' must be a whole number, not 'x'"),
        ("algorithm=dqn", "'algorithm' must be one of 'sac', 'td3', not 'dqn'"),
        ("steps=[1", "broken YAML in line 1"),
        ("steps", "must be of the form key=value"),
        ("=1", "must be of the form key=value"),
        ("noise..base=1", "must be of the form key=value"),
    ],
)
def test_wrong_override_is_named(override, message):
    with pytest.raises(KinfeasError) as caught:
        from_mapping(Recipe, {"robot": "pr2"}, "file.yaml", [override])
    assert str(caught.value).startswith(f"--set {override}: {message}")


def test_error_beside_an_override_is_the_files():
    data = {"robot": "pr2", "noise": {"base": 7}}
    with pytest.raises(KinfeasError, match=r"^file.yaml: 'noise.base' must be"):
        from_mapping(Recipe, data, "file.yaml", ["noise.lag=1", "steps=2"])
