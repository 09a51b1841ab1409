import json
from itertools import pairwise

import numpy as np
import pytest
from safetensors.numpy import load_file, save_file

from kinfeas import registry
from kinfeas.errors import KinfeasError
from kinfeas.observation import CLIP
from kinfeas.policy import Network, Situation, read_network, write_network


def network(sizes=(28, 256, 256, 3), seed=0):
    rng = np.random.default_rng(seed)
    pairs = list(pairwise(sizes))
    return Network(
        rng.uniform(0.5, 2.0, sizes[0]).astype(np.float32),
        tuple((rng.normal(size=pair) / np.sqrt(pair[0])).astype(np.float32) for pair in pairs),
        tuple(rng.normal(size=pair[1]).astype(np.float32) * np.float32(0.1) for pair in pairs),
    )


def observations(n, inputs=28, seed=1):
    return np.random.default_rng(seed).normal(size=(n, inputs))


def plain(net, observation):
    """Return the network's output in double precision by matrix products."""
    values = np.clip(observation * net.scale.astype(float), -CLIP, CLIP)
    for weight, bias in zip(net.weights[:-1], net.biases[:-1], strict=True):
        values = np.maximum(values @ weight.astype(float) + bias, 0.0)
    return np.tanh(values @ net.weights[-1].astype(float) + net.biases[-1])


def test_is_a_perceptron():
    net, observation = network(), observations(100)
    np.testing.assert_allclose(net(observation), plain(net, observation), atol=1e-5)


@pytest.mark.parametrize("n", [0, 1, 5])
def test_shape_and_bounds(n):
    action = network()(observations(n) * 100.0)
    assert action.shape == (n, 3)
    assert action.dtype == np.float64
    assert np.all(np.abs(action) <= 1.0)


@pytest.mark.parametrize("size", [1, 3, 16, 64, 128])
def test_no_bit_depends_on_the_batch(size):
    net, observation = network(), observations(128)
    together = net(observation)
    for first in range(0, 128, size):
        rows = slice(first, first + size)
        np.testing.assert_array_equal(net(observation[rows]), together[rows])
    order = np.random.default_rng(2).permutation(128)
    np.testing.assert_array_equal(net(observation[order]), together[order])


@pytest.mark.parametrize("sizes", [(28, 3), (28, 7, 2), (26, 400, 300, 3)])
def test_any_number_of_layers(sizes):
    net, observation = network(sizes), observations(10, sizes[0])
    np.testing.assert_allclose(net(observation), plain(net, observation), atol=1e-5)
    np.testing.assert_array_equal(net(observation[:1]), net(observation)[:1])


def test_memory_layout_does_not_matter():
    net, observation = network(), observations(20)
    np.testing.assert_array_equal(net(np.asfortranarray(observation)), net(observation))


def test_acts_on_the_observation_alone():
    net, observation = network(), observations(4)
    nothing = np.full((4, 7), np.nan)
    np.testing.assert_array_equal(
        net.act(Situation(observation, nothing, nothing, nothing, nothing, nothing)),
        net(observation),
    )


@pytest.fixture(scope="module")
def pr2():
    return registry.load_robot("pr2")


def test_what_is_written_is_read_back(pr2, tmp_path):
    net = network()
    write_network(net, tmp_path, pr2, {"steps": 3})
    found = read_network(tmp_path, pr2)
    np.testing.assert_array_equal(found.scale, net.scale)
    np.testing.assert_array_equal(found(observations(9)), net(observations(9)))


SCALE = network().scale


@pytest.mark.parametrize(
    "scale",
    [
        np.full_like(SCALE, np.nan),
        np.full_like(SCALE, np.inf),
        SCALE[:, np.newaxis],
        SCALE[0],
        SCALE.astype(np.float64),
        SCALE.astype(np.int32),
    ],
)
def test_a_broken_scale_is_one_sentence(pr2, tmp_path, scale):
    write_network(network(), tmp_path, pr2, {})
    path = tmp_path / "policy.safetensors"
    save_file({**load_file(path), "scale": np.asarray(scale, order="C")}, path)
    with pytest.raises(KinfeasError, match="broken policy: its scale must be finite numbers"):
        read_network(tmp_path, pr2)


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("layers", float("inf"), "'layers' must be a whole number >= 1, not inf"),
        ("layers", float("nan"), "'layers' must be a whole number >= 1, not nan"),
        ("layers", 3.0, "'layers' must be a whole number >= 1, not 3.0"),
        ("layers", "3", "'layers' must be a whole number >= 1, not '3'"),
        ("layers", 0, "'layers' must be a whole number >= 1, not 0"),
        ("layers", 10**9, "weight"),
        ("format", 99, "'format' must be one of 1, not 99"),
        ("format", None, "'format' must be one of 1, not None"),
        ("robot", ["pr2"], r"'robot' must be a string, not \['pr2'\]"),
    ],
)
def test_a_broken_description_is_one_sentence(pr2, tmp_path, key, value, message):
    write_network(network(), tmp_path, pr2, {key: value})
    with pytest.raises(KinfeasError, match=f"^{tmp_path}: broken policy: .*{message}"):
        read_network(tmp_path, pr2)


@pytest.mark.parametrize("text", ["[" * 100_000, '{"robot": ' * 100_000, "3", "[]", "{}", "null"])
def test_a_foreign_description_is_one_sentence(pr2, tmp_path, text):
    write_network(network(), tmp_path, pr2, {})
    (tmp_path / "policy.json").write_text(text)
    with pytest.raises(KinfeasError, match=f"^{tmp_path}: broken policy: ") as caught:
        read_network(tmp_path, pr2)
    assert "\n" not in str(caught.value)


def test_the_format_that_is_written_is_that_which_is_read(pr2, tmp_path):
    write_network(network(), tmp_path, pr2, {})
    assert json.loads((tmp_path / "policy.json").read_text())["format"] == 1
