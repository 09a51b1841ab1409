"""Checkpoints to resume from: tensors in safetensors, numbers in JSON; nothing is unpickled."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors.torch import load_file, save_file
from stable_baselines3 import SAC
from stable_baselines3.common.buffers import ReplayBuffer

from kinfeas.training.learner import Learner
from kinfeas.training.run import loading, read_state, write_state

_TENSORS = "state.safetensors"
_BUFFER = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")
_UNSIGNED = ".unsigned"  # suffix of unsigned numbers stored as signed

Tensors = dict[str, torch.Tensor]


def save_learner(
    folder: Path, learner: Learner, world: Mapping[str, NDArray[Any]], state: dict[str, Any]
) -> None:
    """Write a learner, a snapshot of its environments and the entries of `state` into a folder."""
    random, random_tensors = _random_state()
    tensors = _world_tensors(world) | random_tensors
    tensors |= {f"policy.{key}": values for key, values in learner.policy.state_dict().items()}
    if (entropy := _learned_entropy(learner)) is not None:
        tensors["log_ent_coef"] = entropy
    optimizers: dict[str, Any] = {}
    for name, optimizer in _optimizers(learner).items():
        saved = optimizer.state_dict()
        optimizers[name] = saved["param_groups"]
        for index, slots in saved["state"].items():
            tensors |= {f"optimizer.{name}.{index}.{slot}": v for slot, v in slots.items()}
    buffer = _buffer(learner)
    for name in _BUFFER:
        tensors[f"buffer.{name}"] = torch.from_numpy(getattr(buffer, name)[: buffer.size()])
    save_file({key: values.contiguous() for key, values in tensors.items()}, folder / _TENSORS)
    about = {
        "optimizers": optimizers,
        "updates": learner._n_updates,
        "buffer": {"position": buffer.pos, "full": buffer.full},
        "random": random,
        **state,
    }
    write_state(folder, about)


def load_learner(folder: Path, learner: Learner) -> dict[str, NDArray[Any]]:
    """Restore a fresh learner from a checkpoint and return the snapshot of the environments.

    The global random states of torch and NumPy, which SB3 draws from, are restored as well.
    """
    about = read_state(folder)
    with loading(folder):
        tensors = load_file(folder / _TENSORS)
        learner.policy.load_state_dict(_below("policy.", tensors))
        if (entropy := _learned_entropy(learner)) is not None:
            entropy.copy_(tensors["log_ent_coef"])
        for name, optimizer in _optimizers(learner).items():
            groups = about["optimizers"][name]
            _load_optimizer(optimizer, groups, _below(f"optimizer.{name}.", tensors))
        _load_buffer(_buffer(learner), about["buffer"], _below("buffer.", tensors))
        learner._n_updates = int(about["updates"])
        _load_random_state(about["random"], tensors)
        return _world_arrays(tensors)


def _load_optimizer(optimizer: torch.optim.Optimizer, groups: Any, tensors: Tensors) -> None:
    state: dict[int, Tensors] = {}
    for key, values in tensors.items():
        index, slot = key.split(".")
        state.setdefault(int(index), {})[slot] = values
    optimizer.load_state_dict({"state": state, "param_groups": groups})


def _load_buffer(buffer: ReplayBuffer, about: Mapping[str, Any], tensors: Tensors) -> None:
    buffer.pos, buffer.full = int(about["position"]), bool(about["full"])
    if not 0 <= buffer.pos < buffer.buffer_size:
        raise ValueError(f"the position of its replay buffer is {buffer.pos}")
    for name in _BUFFER:
        room = getattr(buffer, name)[: buffer.size()]
        room[:] = tensors[name].numpy()


def _random_state() -> tuple[dict[str, Any], Tensors]:
    """Return the global random states, the numbers for JSON and the tensors."""
    kind, keys, position, has_gauss, gauss = np.random.get_state()  # noqa: NPY002 - SB3 draws there
    about = {"kind": kind, "position": position, "has_gauss": has_gauss, "gauss": gauss}
    numpy_keys = torch.from_numpy(np.asarray(keys).astype(np.int64))
    return about, {"random.torch": torch.get_rng_state(), "random.numpy": numpy_keys}


def _load_random_state(about: Mapping[str, Any], tensors: Tensors) -> None:
    torch.set_rng_state(tensors["random.torch"])
    keys = tensors["random.numpy"].numpy().astype(np.uint32)
    state = (about["kind"], keys, about["position"], about["has_gauss"], about["gauss"])
    np.random.set_state(state)  # noqa: NPY002 - as above


def _learned_entropy(learner: Learner) -> torch.Tensor | None:
    """Return the logarithm of SAC's entropy coefficient, if it is learned."""
    if not isinstance(learner, SAC) or learner.log_ent_coef is None:
        return None
    return learner.log_ent_coef.detach()


def _optimizers(learner: Learner) -> dict[str, torch.optim.Optimizer]:
    found = {"actor": learner.actor.optimizer, "critic": learner.critic.optimizer}
    if isinstance(learner, SAC) and learner.ent_coef_optimizer is not None:
        found["entropy"] = learner.ent_coef_optimizer
    return found


def _buffer(learner: Learner) -> ReplayBuffer:
    assert learner.replay_buffer is not None
    return learner.replay_buffer


def _below(prefix: str, tensors: Tensors) -> Tensors:
    return {k.removeprefix(prefix): v for k, v in tensors.items() if k.startswith(prefix)}


def _world_tensors(world: Mapping[str, NDArray[Any]]) -> Tensors:
    """Return the snapshot with unsigned numbers viewed as signed: torch saves no others."""
    tensors = {}
    for key, values in world.items():
        unsigned = values.dtype == np.uint64
        seen = values.view(np.int64) if unsigned else values
        # A copy, since several entries may share memory.
        tensors[f"world.{key}{_UNSIGNED if unsigned else ''}"] = torch.from_numpy(np.array(seen))
    return tensors


def _world_arrays(tensors: Tensors) -> dict[str, NDArray[Any]]:
    world = {}
    for key, tensor in _below("world.", tensors).items():
        unsigned = key.endswith(_UNSIGNED)
        values = tensor.numpy()
        world[key.removesuffix(_UNSIGNED)] = values.view(np.uint64) if unsigned else values
    return world
