"""Checkpoints to resume from: tensors in safetensors, numbers in JSON; nothing is unpickled."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors.numpy import load_file, save_file

from kinfeas.io.files import reading
from kinfeas.training.fast_sac import FastSAC, Replay
from kinfeas.training.run import loading, read_state, write_state

_TENSORS = "state.safetensors"

Arrays = dict[str, NDArray[Any]]


def save_learner(
    folder: Path, learner: FastSAC, world: Mapping[str, NDArray[Any]], state: dict[str, Any]
) -> None:
    """Write a learner, a snapshot of its environments and the entries of `state` into a folder."""
    buffer = _buffer(learner)
    tensors = {f"policy.{key}": values for key, values in learner.policy.state_dict().items()}
    tensors["random"] = torch.get_rng_state()
    if (entropy := _learned_entropy(learner)) is not None:
        tensors["log_ent_coef"] = entropy
    for name, optimizer in _optimizers(learner).items():
        for index, slots in optimizer.state_dict()["state"].items():
            tensors |= {f"optimizer.{name}.{index}.{slot}": v for slot, v in slots.items()}
    arrays: Arrays = {f"world.{key}": values for key, values in world.items()}
    arrays |= {key: values.numpy() for key, values in tensors.items()}
    arrays["buffer"] = buffer.rows[: buffer.size()]
    save_file({key: np.array(a, order="C") for key, a in arrays.items()}, folder / _TENSORS)
    about = {
        "updates": learner._n_updates,
        "buffer": {"position": buffer.pos, "full": buffer.full},
        **state,
    }
    write_state(folder, about)


def load_learner(folder: Path, learner: FastSAC) -> Arrays:
    """Restore a fresh learner from a checkpoint and return the snapshot of the environments.

    The random state of torch, from which learners draw, is restored as well.
    """
    about = read_state(folder)
    with loading(folder):
        with reading(folder / _TENSORS):
            arrays = load_file(folder / _TENSORS)
        buffer = _buffer(learner)
        buffer.pos, buffer.full = int(about["buffer"]["position"]), bool(about["buffer"]["full"])
        buffer.rows[: buffer.size()] = arrays["buffer"]
        learner.policy.load_state_dict(_tensors("policy.", arrays))
        if (entropy := _learned_entropy(learner)) is not None:
            entropy.copy_(torch.from_numpy(arrays["log_ent_coef"]))
        for name, optimizer in _optimizers(learner).items():
            state: dict[int, dict[str, torch.Tensor]] = {}
            for key, values in _tensors(f"optimizer.{name}.", arrays).items():
                index, slot = key.split(".")
                state.setdefault(int(index), {})[slot] = values
            optimizer.load_state_dict({**optimizer.state_dict(), "state": state})
        learner._n_updates = int(about["updates"])
        torch.set_rng_state(torch.from_numpy(arrays["random"]))
        return _below("world.", arrays)


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


def _buffer(learner: FastSAC) -> Replay:
    assert isinstance(learner.replay_buffer, Replay)
    return learner.replay_buffer


def _below(prefix: str, arrays: Arrays) -> Arrays:
    return {k.removeprefix(prefix): v for k, v in arrays.items() if k.startswith(prefix)}


def _tensors(prefix: str, arrays: Arrays) -> dict[str, torch.Tensor]:
    return {key: torch.from_numpy(values) for key, values in _below(prefix, arrays).items()}
