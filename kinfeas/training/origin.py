"""What a run goes on from: the policy that its configuration names."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinfeas.core.errors import KinfeasError
from kinfeas.policies import pretrained
from kinfeas.policies.network import Network, read_network
from kinfeas.robots.loading import load_robot
from kinfeas.training.config import TrainConfig


def fitted(config: TrainConfig) -> TrainConfig:
    """Return the configuration with the layers and the lasting name of what it goes on from.

    Raises:
        KinfeasError: If that policy cannot be read, or is none that was trained.
    """
    if config.init is None:
        return config
    net_arch = tuple(len(bias) for bias in _load(config).biases[:-1])
    init = config.init if config.init == pretrained.NAME else str(Path(config.init).absolute())
    return replace(config, init=init, learner=replace(config.learner, net_arch=net_arch))


def first_policy(config: TrainConfig, scale: NDArray[np.float32]) -> Network:
    """Return the policy that a run goes on from, which must scale observations alike.

    Args:
        config: Names it: `init` is not None.
        scale: Factor on each observed number in the run's environment, shape (o,).

    Raises:
        KinfeasError: If it cannot be read, is none that was trained, or has another scale.
    """
    network = _load(config)
    if not np.array_equal(network.scale, scale):
        raise KinfeasError(f"init: {config.init} scales observations otherwise")
    return network


def _load(config: TrainConfig) -> Network:
    init, robot = config.init, load_robot(config.robot)
    assert init is not None
    if init == pretrained.NAME:
        return read_network(pretrained.find(robot.name), robot)
    if not (init and Path(init).is_dir()):  # an empty path is the folder that one is in
        raise KinfeasError(
            f"init: {init or repr(init)}: neither the folder of a training run or of a checkpoint "
            f"nor {pretrained.NAME!r}; nothing else has weights to go on from"
        )
    return read_network(Path(init), robot)
