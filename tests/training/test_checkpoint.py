import json
import pickle

import numpy as np
import pytest
import torch
from safetensors.numpy import load_file, save_file

from kinfeas.core.errors import KinfeasError
from kinfeas.envs.world import World
from kinfeas.policies.network import read_network
from kinfeas.robots.loading import load_robot
from kinfeas.tasks.loading import load_task
from kinfeas.training.checkpoint import load_learner, save_learner
from kinfeas.training.learner import explore, make_learner
from kinfeas.training.run import read_state
from kinfeas.training.train import resume
from kinfeas.training.vec_env import WorldVecEnv

ADAPTERS = ["base_noise", "command_latency", "sensor_latency"]


class Toy:
    """A learner and its environments, without train.py."""

    def __init__(self, config):
        self.env = WorldVecEnv(
            World(load_robot(config.robot), load_task("ggr"), config.world, 1), 4
        )
        self.learner = make_learner(config.learner, self.env, 0)
        self.seen = self.env.reset()

    def learn(self, steps):
        for _ in range(steps):
            action = explore(self.learner, self.seen, random=False)
            seen, rewards, dones, infos = self.env.step(action)
            self.learner.replay_buffer.add(self.seen, seen, action, rewards, dones, infos)
            self.seen = seen
            self.learner.train(2, 16)

    def save(self, folder, state=None):
        folder.mkdir()
        save_learner(folder, self.learner, self.env.snapshot(), state or {})

    def load(self, folder):
        self.seen = self.env.restore(load_learner(folder, self.learner, self.env.snapshot()))


@pytest.fixture
def saved(tiny, tmp_path):
    """A checkpoint, and another toy that could load it."""
    config = tiny({"learner.ent_coef": "learned", "world.adapters": ADAPTERS})
    toy = Toy(config)
    toy.learn(3)
    toy.save(tmp_path / "a")
    return tmp_path / "a", Toy(config)


@pytest.mark.parametrize("steps", [3, 40], ids=["buffer not full", "buffer full"])
@pytest.mark.parametrize("settings", [{}, {"learner.ent_coef": "learned"}])
def test_resumes_to_the_bit(tiny, tmp_path, settings, steps):
    config = tiny({"learner.buffer_size": 100, **settings})
    toy = Toy(config)
    toy.learn(steps)
    assert toy.learner.replay_buffer.full == (steps == 40)
    toy.save(tmp_path / "a", {"progress": {"steps": 3}})
    toy.learn(9)
    toy.save(tmp_path / "expected")
    other = Toy(config)
    other.learn(2)
    other.load(tmp_path / "a")
    assert read_state(tmp_path / "a")["progress"] == {"steps": 3}
    other.learn(9)
    other.save(tmp_path / "found")
    expected, found = (load_file(tmp_path / n / "state.safetensors") for n in ("expected", "found"))
    assert expected.keys() == found.keys()
    for key, values in expected.items():
        assert np.array_equal(values, found[key]), key
    texts = [(tmp_path / n / "state.json").read_text() for n in ("expected", "found")]
    assert texts[0] == texts[1]


FORMS = {
    "missing": lambda values: None,
    "shorter": lambda values: values.flatten()[: values.size - 1],
    "a number for all": lambda values: values.flatten()[:1],
    "another type": lambda values: values.astype(np.int8),
}


@pytest.mark.parametrize("form", FORMS)
def test_tensors_of_another_form_raise(saved, form):
    folder, other = saved
    tensors = load_file(folder / "state.safetensors")
    for key in sorted(tensors):
        changed, values = dict(tensors), FORMS[form](tensors[key])
        del changed[key]
        if values is not None:
            if (values.shape, values.dtype) == (tensors[key].shape, tensors[key].dtype):
                continue
            changed[key] = values
        save_file(changed, folder / "state.safetensors")
        with pytest.raises(KinfeasError, match=f"{folder}: "):
            load_learner(folder, other.learner, other.env.snapshot())


@pytest.mark.parametrize(
    ("key", "value"), [("format", 7), ("buffer", {"position": 5, "full": False})]
)
def test_foreign_numbers_raise(saved, key, value):
    folder, other = saved
    path = folder / "state.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), key: value}))
    with pytest.raises(KinfeasError, match=f"{folder}: "):
        other.load(folder)


def test_the_end_of_time_is_no_terminal_state(whole):
    """SB3 multiplies `dones` by `1 - timeouts`."""
    rows = load_file(whole / "checkpoints" / "last" / "state.safetensors")["buffer"]
    dones, timeouts = rows[..., -2], rows[..., -1]
    assert 0 < timeouts.sum() <= dones.sum()
    assert (dones >= timeouts).all()
    # The row that is written next lies between the newest and the oldest.
    roll = -json.loads((whole / "checkpoints/last/state.json").read_text())["buffer"]["position"]
    rows = np.roll(rows, roll, axis=0)
    before, after, goes_on = rows[..., :26], rows[..., 26:52], rows[:-1, :, -2] == 0.0
    np.testing.assert_array_equal(after[:-1][goes_on], before[1:][goes_on])
    assert (np.abs(after[:-1] - before[1:]).max(axis=-1)[~goes_on] > 1e-3).all()


def test_resuming_unpickles_nothing(whole, monkeypatch):
    def refuse(*_, **__):
        raise AssertionError("unpickled")

    for name in ("load", "loads", "Unpickler"):
        monkeypatch.setattr(pickle, name, refuse)
    monkeypatch.setattr(torch, "load", refuse)
    assert resume(whole).steps == 320
    assert read_network(whole, load_robot("hsr")).weights
