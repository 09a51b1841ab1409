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
from kinfeas.training.learner import explore, load_learner, make_learner, save_learner
from kinfeas.training.train import resume
from kinfeas.training.vec_env import WorldVecEnv

ADAPTERS = ["base_noise", "command_latency", "sensor_latency"]


@pytest.fixture
def saved(tiny, tmp_path):
    """The folder of a checkpoint, and a fresh learner and snapshot that could be loaded from it."""
    config = tiny({"world.adapters": ADAPTERS})

    def make():
        world = World(load_robot(config.robot), load_task("ggr"), config.world, 1)
        env = WorldVecEnv(world, 4)
        return make_learner(config.learner, env, 0), env, env.reset()

    learner, env, seen = make()
    for _ in range(3):
        action = explore(learner, seen, random=False)
        after, rewards, dones, infos = env.step(action)
        learner.replay_buffer.add(seen, after, action, rewards, dones, infos)
        seen = after
    learner.train(2, 16)
    save_learner(tmp_path, learner, env.snapshot(), {"arrays": None})  # of unknown hash
    other, fresh, _ = make()
    return tmp_path, other, fresh.snapshot()


FORMS = {
    "missing": lambda values: None,
    "shorter": lambda values: values.flatten()[: values.size - 1],
    "a number for all": lambda values: values.flatten()[:1],
    "another type": lambda values: values.astype(np.int8),
}


@pytest.mark.parametrize("form", FORMS)
def test_tensors_of_another_form_raise(saved, form):
    folder, learner, snapshot = saved
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
            load_learner(folder, learner, snapshot)


@pytest.mark.parametrize(
    ("key", "value"), [("format", 7), ("buffer", {"position": 5, "full": False})]
)
def test_foreign_numbers_raise(saved, key, value):
    folder, learner, snapshot = saved
    path = folder / "state.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), key: value}))
    with pytest.raises(KinfeasError, match=f"{folder}: "):
        load_learner(folder, learner, snapshot)


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


def test_all_files_have_the_mode_of_the_umask(whole):
    files = (whole / "metrics.csv", *(whole / "checkpoints" / "last").iterdir())
    assert len({path.stat().st_mode for path in files}) == 1


def test_resuming_unpickles_nothing(whole, monkeypatch):
    def refuse(*_, **__):
        raise AssertionError("unpickled")

    for name in ("load", "loads", "Unpickler"):
        monkeypatch.setattr(pickle, name, refuse)
    monkeypatch.setattr(torch, "load", refuse)
    assert resume(whole).steps == 320
    assert read_network(whole, load_robot("hsr")).weights
