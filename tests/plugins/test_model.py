import copy
import math
from pathlib import Path

import numpy as np
import pytest

from kinfeas import config
from kinfeas.config import strict_yaml
from kinfeas.core import registry
from kinfeas.core.errors import KinfeasError
from kinfeas.plugins import imitation as module
from kinfeas.plugins.fit import write_model
from kinfeas.plugins.imitation import Model, learned_path, read_model, shipped_models
from kinfeas.testing import check_motion_generator
from tests.plugins.conftest import KINDS


@pytest.fixture(scope="module")
def plain(models):
    """An `imitation` model as plain data."""
    return strict_yaml.read(Path(models["imitation"]))


@pytest.mark.parametrize("kind", KINDS)
def test_a_file_read_and_written_again_is_the_same(kind, models, tmp_path):
    path = tmp_path / "again.yaml"
    write_model(read_model(models[kind], kind), path)
    assert path.read_text() == Path(models[kind]).read_text()
    assert path.stat().st_size < 30_000


@pytest.mark.parametrize("name", ["imitation", "nobase"])
def test_knows_whether_there_is_a_base(name, models):
    assert read_model(models[name], "imitation").has_base == (name != "nobase")


@pytest.mark.parametrize("name", shipped_models())
def test_shipped_models_are_small_and_keep_the_contract(name):
    path = Path(module.__file__).parent / "models" / f"{name}.yaml"
    assert path.stat().st_size < 30_000
    model = config.load(Model, path)
    assert model.has_base
    generator = registry.build("kinfeas.motion_generators", model.kind, {"model": name})
    check_motion_generator(generator)


def test_a_shipped_model_goes_by_its_name(models, tmp_path, monkeypatch):
    monkeypatch.setattr(module, "_FOLDER", Path(models["imitation"]).parent)
    assert shipped_models() == ["gaussian_mixture", "imitation", "nobase"]
    assert read_model("imitation", "imitation") == read_model(models["imitation"], "imitation")
    with pytest.raises(KinfeasError, match=r"unknown model 'imitatio' \(did you mean 'imitation'"):
        read_model("imitatio", "imitation")
    assert shipped_models("gaussian_mixture") == ["gaussian_mixture"]
    for missing in (None, 3):
        with pytest.raises(KinfeasError, match=r"shipped one: imitation, nobase$"):
            read_model(missing, "imitation")
    with pytest.raises(KinfeasError, match=r"here\.yaml: cannot be read"):
        read_model("here.yaml", "imitation")


def test_refuses_a_model_of_another_kind(models):
    with pytest.raises(KinfeasError, match="'kind' must be 'gaussian_mixture' here, not 'imit"):
        read_model(models["imitation"], "gaussian_mixture")


@pytest.mark.parametrize(
    ("keys", "value", "message"),
    [
        (["format"], 2, "'format'"),
        (["kind"], "spline", "'kind'"),
        (["colour"], "red", "unknown key 'colour'"),
        (["duration"], 0.0, "'duration'"),
        (["duration"], math.nan, "'duration'"),
        (["goal"], [0.0] * 6, "'goal'"),
        (["goal", 6], 2.0, "'goal' must have a unit quaternion"),
        (["goal", 0], 1e9, r"'goal.0'"),
        (["mean_orientation"], [0.0] * 4, "'mean_orientation' must have a unit quaternion"),
        (["fitted_from", "demonstrations"], 0, "'fitted_from.demonstrations' must be"),
        (["components"], [], "'components'"),
        (["components", 0, "covariance", 0, 0], 0.0, "'components.0': the variance of the index"),
        (["components", 0, "weight"], 0.9, "the weights of 'components' must add up to 1"),
        (["components", 0, "weight"], -0.1, "'components.0.weight'"),
        (["components", 1, "mean", 2], math.inf, "'components.1.mean.2'"),
        (["components", 1, "mean"], [0.0] * 8, "'components.1': the mean must have 7 or 10 num"),
        (["components", 1, "covariance"], [[1.0]], "'components.1': the covariance must have 10"),
        (["components", 1, "covariance", 3, 3], math.nan, "covariance.3.3'"),
        (["components", 1, "covariance", 3, 3], "wide", "covariance.3.3'"),
    ],
)
def test_refuses_what_is_no_model(keys, value, message, plain, tmp_path):
    broken = copy.deepcopy(plain)
    *above, last = keys
    entry = broken
    for key in above:
        entry = entry[key]
    entry[last] = value
    path = tmp_path / "broken.yaml"
    strict_yaml.write(broken, path)
    with pytest.raises(KinfeasError, match=message) as caught:
        read_model(str(path), "imitation")
    assert str(caught.value).startswith(f"{path}: ")


def test_only_the_first_column_of_a_covariance_counts(plain):
    bare = copy.deepcopy(plain)
    for component in bare["components"]:
        component["covariance"] = [[row[0]] + [0.0] * 9 for row in component["covariance"]]
    paths = [learned_path(config.from_mapping(Model, one, "model")) for one in (plain, bare)]
    assert np.array_equal(paths[0].knots, paths[1].knots)


def test_refuses_components_of_different_sizes(plain, tmp_path):
    broken = copy.deepcopy(plain)
    broken["components"][0]["mean"] = [0.0] * 7
    broken["components"][0]["covariance"] = np.eye(7).tolist()
    path = tmp_path / "broken.yaml"
    strict_yaml.write(broken, path)
    with pytest.raises(KinfeasError, match="'components'"):
        read_model(str(path), "imitation")


def test_a_file_never_runs_code(tmp_path):
    path = tmp_path / "evil.yaml"
    path.write_text("format: !!python/object/apply:os.abort []\n")
    with pytest.raises(KinfeasError, match="broken YAML"):
        read_model(str(path), "imitation")
