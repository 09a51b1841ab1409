"""Checkpoints to resume from: tensors in safetensors, numbers in JSON, written atomically."""

import json
import os
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from stable_baselines3 import SAC

from kinfeas.errors import KinfeasError
from kinfeas.training.learner import Learner

_FORMAT = 1
_BUFFER = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")


def write_folder(folder: Path, fill: Any) -> None:
    """Let `fill(path)` write into a new folder that takes the place of `folder` when complete."""
    fresh = folder.with_name(f".{folder.name}.new")
    old = folder.with_name(f".{folder.name}.old")
    for leftover in (fresh, old):
        shutil.rmtree(leftover, ignore_errors=True)
    fresh.mkdir(parents=True)
    fill(fresh)
    if folder.exists():
        os.rename(folder, old)
    os.rename(fresh, folder)
    shutil.rmtree(old, ignore_errors=True)


def find_folder(folder: Path) -> Path:
    """Return `folder`, or what a run killed while writing it left in its place."""
    old = folder.with_name(f".{folder.name}.old")
    return old if old.is_dir() and not folder.is_dir() else folder


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
    tensors = {f"world.{key}": torch.from_numpy(np.array(values)) for key, values in _signed(world)}
    tensors |= {f"policy.{key}": values for key, values in learner.policy.state_dict().items()}
    optimizers: dict[str, Any] = {}
    for name, optimizer in _optimizers(learner).items():
        saved = optimizer.state_dict()
        optimizers[name] = saved["param_groups"]
        for index, slots in saved["state"].items():
            tensors |= {f"optimizer.{name}.{index}.{slot}": v for slot, v in slots.items()}
    if isinstance(learner, SAC) and learner.ent_coef_optimizer is not None:
        tensors["log_ent_coef"] = learner.log_ent_coef.detach()
    buffer = learner.replay_buffer
    assert buffer is not None
    filled = buffer.buffer_size if buffer.full else buffer.pos
    for name in _BUFFER:
        tensors[f"buffer.{name}"] = torch.from_numpy(getattr(buffer, name)[:filled])
    kind, keys, position, has_gauss, gauss = np.random.get_state()  # noqa: NPY002 - SB3 samples from it
    tensors["random.torch"] = torch.get_rng_state()
    tensors["random.numpy"] = torch.from_numpy(np.asarray(keys).astype(np.int64))
    save_file({key: t.clone().contiguous() for key, t in tensors.items()}, folder / "state.safetensors")
    about = {
        "format": _FORMAT,
        "optimizers": optimizers,
        "updates": learner._n_updates,
        "buffer": {"position": buffer.pos, "full": buffer.full},
        "random": {"kind": kind, "position": position, "has_gauss": has_gauss, "gauss": gauss},
        **state,
    }
    (folder / "state.json").write_text(json.dumps(about), encoding="utf-8")


def load_learner(folder: Path, learner: Learner) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    """Bring a fresh learner to where a checkpoint left off.

    Returns:
        The snapshot of the environments, and the state that was saved beside it.

    Raises:
        KinfeasError: If the checkpoint is missing, truncated, or of another configuration.
    """
    try:
        about = json.loads((folder / "state.json").read_text(encoding="utf-8"))
        tensors = load_file(folder / "state.safetensors")
        _fill(learner, about, tensors)
    except FileNotFoundError as error:
        raise KinfeasError(f"{folder}: no checkpoint to resume: there is no {error.filename}") from error
    except (OSError, SafetensorError, ValueError, KeyError, TypeError, RuntimeError) as error:
        reason = str(error).splitlines()[0]
        raise KinfeasError(f"{folder}: broken checkpoint, or one of another run: {reason}") from error
    world = {k.removeprefix("world."): v.numpy() for k, v in tensors.items() if k.startswith("world.")}
    world = {k.removesuffix(_UNSIGNED): v.view(np.uint64) if k.endswith(_UNSIGNED) else v for k, v in world.items()}
    return world, about


def _fill(learner: Learner, about: dict[str, Any], tensors: dict[str, torch.Tensor]) -> None:
    prefix = "policy."
    learner.policy.load_state_dict(
        {k.removeprefix(prefix): v for k, v in tensors.items() if k.startswith(prefix)}
    )
    if isinstance(learner, SAC) and learner.ent_coef_optimizer is not None:
        learner.log_ent_coef.data.copy_(tensors["log_ent_coef"])
    for name, optimizer in _optimizers(learner).items():
        state: dict[int, dict[str, torch.Tensor]] = {}
        for key, values in tensors.items():
            if key.startswith(f"optimizer.{name}."):
                index, slot = key.removeprefix(f"optimizer.{name}.").split(".")
                state.setdefault(int(index), {})[slot] = values
        optimizer.load_state_dict({"state": state, "param_groups": about["optimizers"][name]})
    buffer = learner.replay_buffer
    assert buffer is not None
    for name in _BUFFER:
        values = tensors[f"buffer.{name}"].numpy()
        getattr(buffer, name)[: len(values)] = values
    buffer.pos, buffer.full = about["buffer"]["position"], about["buffer"]["full"]
    learner._n_updates = about["updates"]
    torch.set_rng_state(tensors["random.torch"])
    random = about["random"]
    keys = tensors["random.numpy"].numpy().astype(np.uint32)
    np.random.set_state((random["kind"], keys, random["position"], random["has_gauss"], random["gauss"]))  # noqa: NPY002


def _optimizers(learner: Learner) -> dict[str, torch.optim.Optimizer]:
    found = {"actor": learner.actor.optimizer, "critic": learner.critic.optimizer}
    if isinstance(learner, SAC) and learner.ent_coef_optimizer is not None:
        found["entropy"] = learner.ent_coef_optimizer
    return found


_UNSIGNED = ".unsigned"


def _signed(world: Mapping[str, NDArray[Any]]) -> list[tuple[str, NDArray[Any]]]:
    """Return the arrays with unsigned ones seen as signed: torch has no 64 bits without a sign."""
    return [
        (key + _UNSIGNED, values.view(np.int64)) if values.dtype == np.uint64 else (key, values)
        for key, values in world.items()
    ]
