"""Checkpoints to resume from: tensors in safetensors, numbers in JSON; nothing is unpickled."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors.torch import load_file, save_file
from stable_baselines3 import SAC

from kinfeas.config import Interval
from kinfeas.training.learner import Learner
from kinfeas.training.state import Tally, checked, loading, read_state, write_state

_TENSORS = "state.safetensors"
_BUFFER = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")
_WORLD = ("world.base_pose", "world.joint_positions", "world.sent", "world.desired")
_FINITE = ("policy.", "buffer.", "log_ent_coef", *_WORLD)
"""What the names of tensors begin with in which every number is finite."""
_STATES = "world.motion."
"""What the names of motions' states begin with."""
_UNSIGNED = ".unsigned"

Tensors = dict[str, torch.Tensor]


@dataclass(frozen=True)
class _Buffer:
    """How far the replay buffer is filled."""

    position: Tally
    full: bool


@dataclass(frozen=True)
class _Random:
    """NumPy's global random state, less its keys."""

    kind: Literal["MT19937"]
    position: Annotated[int, Interval(low=0, high=624)]
    has_gauss: Annotated[int, Interval(low=0, high=1)]
    gauss: float


@dataclass(frozen=True)
class _Numbers:
    """What of a learner is no tensor."""

    updates: Tally
    buffer: _Buffer
    random: _Random


def save_learner(
    folder: Path, learner: Learner, world: Mapping[str, NDArray[Any]], state: dict[str, Any]
) -> None:
    """Write all that a run goes on from into an existing folder.

    Args:
        folder: Where to write.
        learner: Networks, optimizers, replay buffer.
        world: Snapshot of the environments.
        state: Counters and whatever else fits into JSON.
    """
    random, random_tensors = _random_state()
    tensors = _tensors(learner, world) | random_tensors
    optimizers: dict[str, Any] = {}
    for name, optimizer in _optimizers(learner).items():
        saved = optimizer.state_dict()
        optimizers[name] = saved["param_groups"]
        for index, slots in saved["state"].items():
            tensors |= {f"optimizer.{name}.{index}.{slot}": v for slot, v in slots.items()}
    buffer = learner.replay_buffer
    assert buffer is not None
    filled = buffer.buffer_size if buffer.full else buffer.pos
    for name in _BUFFER:
        tensors[f"buffer.{name}"] = tensors[f"buffer.{name}"][:filled]
    save_file({key: values.contiguous() for key, values in tensors.items()}, folder / _TENSORS)
    about = {
        "optimizers": optimizers,
        "updates": learner._n_updates,
        "buffer": {"position": buffer.pos, "full": buffer.full},
        "random": random,
        **state,
    }
    write_state(folder, about)


def load_learner(
    folder: Path, learner: Learner, world: Mapping[str, NDArray[Any]]
) -> dict[str, NDArray[Any]]:
    """Bring a fresh learner to where a checkpoint left off; return the num_envs' snapshot.

    The global random numbers of torch and NumPy, which SB3 draws from, go on from there, too.

    Args:
        folder: Where to read.
        learner: Networks, optimizers, replay buffer.
        world: A fresh snapshot of the environments, which the saved one has to be like.

    Raises:
        KinfeasError: If the checkpoint is missing, truncated, or of another configuration.
    """
    about = read_state(folder)
    with loading(folder):
        entries = {key: about[key] for key in ("updates", "buffer", "random")}
        numbers = checked(_Numbers, entries)
        tensors = load_file(folder / _TENSORS)
        _check_layout(tensors, learner, world)
        _check_finite(tensors)
        learner.policy.load_state_dict(_below("policy.", tensors))
        if (entropy := _learned_entropy(learner)) is not None:
            entropy.copy_(tensors["log_ent_coef"])
        for name, optimizer in _optimizers(learner).items():
            _load_optimizer(
                optimizer, about["optimizers"][name], _below(f"optimizer.{name}.", tensors)
            )
        _load_buffer(learner, numbers.buffer, _below("buffer.", tensors))
        learner._n_updates = numbers.updates
        _load_random_state(numbers.random, tensors)
        return _world_arrays(tensors)


def _tensors(learner: Learner, world: Mapping[str, NDArray[Any]]) -> Tensors:
    """Return a checkpoint's tensors, the buffer whole, but for optimizers and random states."""
    tensors = _world_tensors(world)
    tensors |= {f"policy.{key}": values for key, values in learner.policy.state_dict().items()}
    if (entropy := _learned_entropy(learner)) is not None:
        tensors["log_ent_coef"] = entropy
    for name in _BUFFER:
        tensors[f"buffer.{name}"] = torch.from_numpy(getattr(learner.replay_buffer, name))
    return tensors


def _check_layout(tensors: Tensors, learner: Learner, world: Mapping[str, NDArray[Any]]) -> None:
    """Raise unless names, shapes and types are those that the learner would save.

    Motions that have not begun have no state yet, and adapters begin with one slot and add more.
    """
    wanted = _tensors(learner, world) | _random_state()[1]
    for name, optimizer in _optimizers(learner).items():
        for index, values in enumerate(optimizer.param_groups[0]["params"]):
            slots = {"step": torch.zeros(()), "exp_avg": values, "exp_avg_sq": values}
            slots = {f"optimizer.{name}.{index}.{slot}": like for slot, like in slots.items()}
            # Those of a network that has not learned yet are not there.
            wanted |= slots if slots.keys() & tensors.keys() else {}
    rows = {len(wanted[key]) for key in ("world.steps",) if key in wanted}
    grown: dict[str, int] = {}
    for key in sorted(wanted.keys() | tensors.keys()):
        found, like = tensors.get(key), wanted.get(key)
        if found is None:
            raise ValueError(f"{key} is missing")
        shape = tuple(found.shape)
        if like is None:
            if not key.startswith(_STATES) or shape[:1] != (*rows,):
                raise ValueError(f"{key} is unknown")
            continue
        expected = [*like.shape]
        if key.startswith("buffer."):
            expected[0] = len(found)
        elif key.startswith("world.") and expected[1:2] == [1] and len(shape) > 1:
            expected[1] = grown.setdefault(key.rpartition(".")[0], shape[1])
        if shape != tuple(expected) or found.dtype != like.dtype:
            raise ValueError(
                f"{key} holds {found.dtype} of shape {shape}, not {like.dtype} of shape "
                f"{tuple(expected)}"
            )


def _check_finite(tensors: Tensors) -> None:
    for key, values in tensors.items():
        if key.startswith(_FINITE) and not torch.isfinite(values).all():
            raise ValueError(f"{key} holds numbers that are not finite")


def _load_optimizer(optimizer: torch.optim.Optimizer, groups: Any, tensors: Tensors) -> None:
    state: dict[int, Tensors] = {}
    for key, values in tensors.items():
        index, slot = key.split(".")
        state.setdefault(int(index), {})[slot] = values
    optimizer.load_state_dict({"state": state, "param_groups": groups})


def _load_buffer(learner: Learner, about: _Buffer, tensors: Tensors) -> None:
    buffer = learner.replay_buffer
    assert buffer is not None
    if about.position >= buffer.buffer_size:
        raise ValueError(f"its replay buffer goes on beyond its size of {buffer.buffer_size}")
    buffer.pos, buffer.full = about.position, about.full
    filled = buffer.buffer_size if buffer.full else buffer.pos
    for name in _BUFFER:
        room, values = getattr(buffer, name), tensors[name].numpy()
        # Assignment alone would stretch one row over many.
        if values.shape != (filled, *room.shape[1:]):
            raise ValueError(f"its replay buffer holds {name} of shape {values.shape}")
        room[:filled] = values


def _random_state() -> tuple[dict[str, Any], Tensors]:
    """Return the global random states as what goes into JSON and what goes into tensors."""
    kind, keys, position, has_gauss, gauss = np.random.get_state()  # noqa: NPY002 - SB3 draws there
    about = {"kind": kind, "position": position, "has_gauss": has_gauss, "gauss": gauss}
    numpy_keys = torch.from_numpy(np.asarray(keys).astype(np.int64))
    return about, {"random.torch": torch.get_rng_state(), "random.numpy": numpy_keys}


def _load_random_state(about: _Random, tensors: Tensors) -> None:
    torch.set_rng_state(tensors["random.torch"])
    keys = tensors["random.numpy"].numpy().astype(np.uint32)
    state = (about.kind, keys, about.position, about.has_gauss, about.gauss)
    np.random.set_state(state)  # noqa: NPY002 - as above


def _optimizers(learner: Learner) -> dict[str, torch.optim.Optimizer]:
    found = {"actor": learner.actor.optimizer, "critic": learner.critic.optimizer}
    if isinstance(learner, SAC) and learner.ent_coef_optimizer is not None:
        found["entropy"] = learner.ent_coef_optimizer
    return found


def _learned_entropy(learner: Learner) -> torch.Tensor | None:
    """Return the logarithm of SAC's entropy coefficient, if it is learned."""
    if not isinstance(learner, SAC) or learner.log_ent_coef is None:
        return None
    return learner.log_ent_coef.detach()


def _below(prefix: str, tensors: Tensors) -> Tensors:
    return {k.removeprefix(prefix): v for k, v in tensors.items() if k.startswith(prefix)}


def _world_tensors(world: Mapping[str, NDArray[Any]]) -> Tensors:
    """Return the snapshot with unsigned numbers seen as signed: torch saves no others."""
    tensors = {}
    for key, values in world.items():
        unsigned = values.dtype == np.uint64
        seen = values.view(np.int64) if unsigned else values
        # A copy, since several entries may show the same memory.
        tensors[f"world.{key}{_UNSIGNED if unsigned else ''}"] = torch.from_numpy(np.array(seen))
    return tensors


def _world_arrays(tensors: Tensors) -> dict[str, NDArray[Any]]:
    world = {}
    for key, tensor in _below("world.", tensors).items():
        unsigned = key.endswith(_UNSIGNED)
        values = tensor.numpy()
        world[key.removesuffix(_UNSIGNED)] = values.view(np.uint64) if unsigned else values
    return world
