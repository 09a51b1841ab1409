"""SAC of Stable-Baselines3 as a learner, the networks that it learns, and its checkpoints.

Checkpoints are arrays in safetensors and numbers in JSON; nothing is unpickled.
"""

import math
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors.numpy import load_file, save_file
from stable_baselines3 import SAC
from stable_baselines3.common.logger import Logger
from torch import nn

from kinfeas.core.errors import KinfeasError
from kinfeas.core.files import check_undamaged, file_hash, reading
from kinfeas.policies.network import Network, write_network
from kinfeas.training.config import LearnerConfig
from kinfeas.training.fast_sac import FastReplayBuffer, FastSAC, linear_layers
from kinfeas.training.run import STATE, loading, read_state, write_state
from kinfeas.training.vec_env import EpisodesVecEnv

_ARRAYS = "state.safetensors"
_MOTION = "world.motion."  # prefix of the states of motions

Arrays = dict[str, NDArray[Any]]

INITIAL_STD = 0.1
"""Standard deviation of the actions, before tanh, when training starts from a policy."""


class DivergedError(KinfeasError):
    """Losses or weights of a learner are no longer finite."""


def make_learner(config: LearnerConfig, env: EpisodesVecEnv, seed: int) -> FastSAC:
    """Return a fresh learner whose random numbers are seeded."""
    # Small networks gain nothing from a second thread, and threads that wait for each other lose
    # most of their time as soon as another process wants a core.
    torch.set_num_threads(1)
    rate, linear = config.learning_rate, config.schedule == "linear"
    learner = FastSAC(
        policy="MlpPolicy",
        env=env,
        learning_rate=(lambda remaining: rate * remaining) if linear else rate,
        batch_size=config.batch_size,
        gradient_steps=config.gradient_steps,
        gamma=config.gamma,
        tau=config.tau,
        buffer_size=max(config.buffer_size, env.num_envs),
        learning_starts=config.learning_starts,
        policy_kwargs={"net_arch": list(config.net_arch), "optimizer_kwargs": {"fused": True}},
        replay_buffer_class=FastReplayBuffer,
        ent_coef="auto" if config.ent_coef == "learned" else config.ent_coef,
        seed=seed,
        device="cpu",
    )
    learner.policy_delay = config.policy_delay
    learner.set_logger(Logger(None, []))
    return learner


@contextmanager
def without_denormals() -> Iterator[None]:
    """Round denormal numbers to 0 within the block, in this thread: optimizers are slow with them.

    The processor does so for all code of the thread, hence not permanently.
    """
    torch.set_flush_denormal(True)
    try:
        yield
    finally:
        torch.set_flush_denormal(False)


def explore(
    learner: FastSAC, observation: NDArray[np.float32], *, random: bool
) -> NDArray[np.float32]:
    """Return actions to learn from, shape (n, a), for scaled observations, shape (n, d).

    They are drawn with torch's generator; `random` ones are uniform, without the actor.
    """
    if random:
        assert learner.action_space.shape is not None
        return (2.0 * torch.rand(len(observation), *learner.action_space.shape) - 1.0).numpy()
    with torch.no_grad():
        return learner.draw(torch.from_numpy(observation)).numpy()


def learn(learner: FastSAC, config: LearnerConfig) -> None:
    """Take the gradient steps of one step of all environments."""
    learner.train(config.gradient_steps, config.batch_size)
    check_finite(learner.finite(), config)


def check_finite(finite: bool, config: LearnerConfig) -> None:
    """Raise DivergedError unless losses or weights are `finite`."""
    if not finite:
        rate = config.learning_rate
        raise DivergedError(
            f"learning diverged: learner.learning_rate is {rate:g}, try a lower one"
        )


def network_of(learner: SAC, env: EpisodesVecEnv) -> Network:
    """Return the learner's deterministic actor as a network that runs without torch."""
    weights = tuple(layer.weight.detach().numpy().T.copy() for layer in _layers(learner))
    biases = tuple(layer.bias.detach().numpy().copy() for layer in _layers(learner))
    return Network(env.scale, weights, biases, env.observation_terms)


def save_policy(model: SAC, env: EpisodesVecEnv, folder: Path) -> None:
    """Write the policy of a Stable-Baselines3 model for `evaluate`, `export` and `deploy`.

    The model is SAC or TQC, with `MlpPolicy` and ReLU layers; `env`, that of its training,
    determines robot and observation scale. `policy.json` and `policy.safetensors` are written into
    the existing folder.

    Raises:
        KinfeasError: If the model is of another algorithm, or the actor has other layers.
    """
    if not hasattr(getattr(model, "actor", None), "latent_pi"):
        raise KinfeasError(f"the algorithm must be SAC or TQC, not {type(model).__name__}")
    hidden: Any = model.actor.latent_pi
    layers = [*hidden, model.actor.features_extractor]
    if others := {type(m).__name__ for m in layers} - {"Linear", "ReLU", "FlattenExtractor"}:
        raise KinfeasError(f"the actor must have ReLU layers, not {', '.join(sorted(others))}")
    write_network(network_of(model, env), folder, env.robot, {"steps": model.num_timesteps})


def take_network(
    learner: FastSAC, network: Network, anchor: float = 0.0, surroundings: Sequence[int] = ()
) -> None:
    """Copy a network into a fresh learner's actor, whose hidden layers are as wide.

    Its actions get the standard deviation `INITIAL_STD`. A positive `anchor` holds the actor near
    the network where all inputs with the indices `surroundings` that it ignores are 0.
    """
    with torch.no_grad():
        for layer, weight, bias in zip(
            _layers(learner), network.weights, network.biases, strict=True
        ):
            layer.weight.copy_(torch.from_numpy(weight.T.copy()))
            layer.bias.copy_(torch.from_numpy(bias))
        log_std: Any = learner.actor.log_std  # a layer, unlike its annotation
        log_std.weight.zero_()
        log_std.bias.fill_(math.log(INITIAL_STD))
    ignored = [number for number in surroundings if not network.weights[0][number].any()]
    learner.anchor(anchor, ignored)


def _layers(learner: SAC) -> list[nn.Linear]:
    """Return the layers that lead to the deterministic action, in order."""
    return [*linear_layers(learner.actor.latent_pi), *linear_layers(learner.actor.mu)]


def save_learner(
    folder: Path, learner: FastSAC, world: Mapping[str, NDArray[Any]], state: dict[str, Any]
) -> None:
    """Write a learner, a snapshot of its environments and the entries of `state` into a folder."""
    save_file(_arrays(learner, world), folder / _ARRAYS)
    buffer = learner.replay_buffer
    position = {"position": buffer.pos, "full": buffer.full}
    about = {"updates": learner._n_updates, "buffer": position, **state}
    write_state(folder, {"arrays": file_hash(folder / _ARRAYS), **about})
    shutil.copymode(folder / STATE, folder / _ARRAYS)  # `save_file` writes with mode 0600


def load_learner(
    folder: Path, learner: FastSAC, world: Mapping[str, NDArray[Any]]
) -> dict[str, NDArray[Any]]:
    """Restore a fresh learner from a checkpoint and return the snapshot of the environments.

    The random state of torch, from which learners draw, is restored as well. `world` is a fresh
    snapshot, whose names, types and shapes the saved one must have.
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
    """Return the layout that Adam's state in `arrays` must have; none before the first step."""
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
