"""Checkpoints to resume from: arrays in safetensors, numbers in JSON; nothing is unpickled."""

import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors.numpy import load_file, save_file

from kinfeas.core.files import check_undamaged, file_hash, reading
from kinfeas.training.fast_sac import FastSAC
from kinfeas.training.run import STATE, loading, read_state, write_state

_ARRAYS = "state.safetensors"
_MOTION = "world.motion."  # prefix of the states of motions

Arrays = dict[str, NDArray[Any]]


def save_learner(
    folder: Path, learner: FastSAC, world: Mapping[str, NDArray[Any]], state: dict[str, Any]
) -> None:
    """Write a learner, a snapshot of its environments and the entries of `state` into a folder."""
    save_file(_arrays(learner, world), folder / _ARRAYS)
    buffer = learner.replay_buffer
    position = {"position": buffer.pos, "full": buffer.full}
    about = {"updates": learner._n_updates, "buffer": position, **state}
    write_state(folder, {"arrays": file_hash(folder / _ARRAYS), **about})
    shutil.copymode(folder / STATE, folder / _ARRAYS)  # `save_file` makes it private


def load_learner(
    folder: Path, learner: FastSAC, world: Mapping[str, NDArray[Any]]
) -> dict[str, NDArray[Any]]:
    """Restore a fresh learner from a checkpoint and return the snapshot of the environments.

    The random state of torch, from which learners draw, is restored as well. `world` is a fresh
    snapshot, which the saved one must resemble.
    """
    about = read_state(folder)
    with loading(folder):
        check_undamaged(folder / _ARRAYS, about.get("arrays"))
        with reading(folder / _ARRAYS):
            arrays = load_file(folder / _ARRAYS)
        buffer = learner.replay_buffer
        buffer.pos, buffer.full = int(about["buffer"]["position"]), bool(about["buffer"]["full"])
        if not 0 <= buffer.pos < buffer.buffer_size:
            raise ValueError(f"the position of its replay buffer is {buffer.pos}")
        _check_layout(arrays, _arrays(learner, world) | _optimizer_slots(learner, arrays))
        learner.policy.load_state_dict(_tensors("policy.", arrays))
        if (entropy := _learned_entropy(learner)) is not None:
            entropy.copy_(torch.from_numpy(arrays["log_ent_coef"]))
        for name, optimizer in _optimizers(learner).items():
            _load_optimizer(optimizer, _tensors(f"optimizer.{name}.", arrays))
        buffer.rows[: buffer.size()] = arrays["buffer"]
        learner._n_updates = int(about["updates"])
        torch.set_rng_state(torch.from_numpy(arrays["random"]))
        return _below("world.", arrays)


def _arrays(learner: FastSAC, world: Mapping[str, NDArray[Any]]) -> Arrays:
    tensors = {"random": torch.get_rng_state()}
    tensors |= {f"policy.{key}": values for key, values in learner.policy.state_dict().items()}
    if (entropy := _learned_entropy(learner)) is not None:
        tensors["log_ent_coef"] = entropy
    for name, optimizer in _optimizers(learner).items():
        for index, slots in optimizer.state_dict()["state"].items():
            tensors |= {f"optimizer.{name}.{index}.{slot}": v for slot, v in slots.items()}
    buffer = learner.replay_buffer
    arrays = {f"world.{key}": values for key, values in world.items()}
    arrays |= {key: values.numpy(force=True) for key, values in tensors.items()}
    return arrays | {"buffer": buffer.rows[: buffer.size()]}


def _check_layout(arrays: Arrays, expected: Arrays) -> None:
    """Raise ValueError unless names, types and shapes agree.

    Motions that have not begun have no state yet, and delay buffers grow along axis 1.
    """
    rows = {len(expected[key]) for key in ("world.steps",) if key in expected}
    for key in sorted(arrays.keys() | expected.keys()):
        values, like = arrays.get(key), expected.get(key)
        if like is None and values is not None and key.startswith(_MOTION):
            if {*values.shape[:1]} == rows:
                continue
        elif values is not None and like is not None and values.dtype == like.dtype:
            shape = list(values.shape)
            if key.startswith("world.") and like.shape[1:2] == (1,) and len(shape) > 1:
                shape[1] = 1
            if shape == list(like.shape):
                continue
        raise ValueError(f"{key} is missing, unknown or of another type or shape")


def _optimizer_slots(learner: FastSAC, arrays: Arrays) -> Arrays:
    """Return the state of Adam like that in `arrays`; what has not learned has none."""
    slots: Arrays = {}
    for name, optimizer in _optimizers(learner).items():
        prefix = f"optimizer.{name}."
        if _below(prefix, arrays):
            for index, parameter in enumerate(optimizer.param_groups[0]["params"]):
                values = parameter.numpy(force=True)
                likes = {"step": np.zeros((), np.float32), "exp_avg": values, "exp_avg_sq": values}
                slots |= {f"{prefix}{index}.{slot}": like for slot, like in likes.items()}
    return slots


def _load_optimizer(optimizer: torch.optim.Optimizer, tensors: dict[str, torch.Tensor]) -> None:
    state: dict[int, dict[str, torch.Tensor]] = {}
    for key, values in tensors.items():
        index, slot = key.split(".")
        state.setdefault(int(index), {})[slot] = values
    optimizer.load_state_dict({**optimizer.state_dict(), "state": state})


def _learned_entropy(learner: FastSAC) -> torch.Tensor | None:
    """Return the logarithm of SAC's entropy coefficient, if it is learned."""
    if learner.log_ent_coef is None:
        return None
    return learner.log_ent_coef.detach()


def _optimizers(learner: FastSAC) -> dict[str, torch.optim.Optimizer]:
    optimizers = {"actor": learner.actor.optimizer, "critic": learner.critic.optimizer}
    if learner.ent_coef_optimizer is not None:
        optimizers["entropy"] = learner.ent_coef_optimizer
    return optimizers


def _below(prefix: str, arrays: Arrays) -> Arrays:
    return {k.removeprefix(prefix): v for k, v in arrays.items() if k.startswith(prefix)}


def _tensors(prefix: str, arrays: Arrays) -> dict[str, torch.Tensor]:
    return {key: torch.from_numpy(values) for key, values in _below(prefix, arrays).items()}
