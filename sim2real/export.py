"""Writing a trained policy as one ONNX file that describes itself."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from kinfeas import __version__
from kinfeas.control.observation import CLIP, HORIZON
from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import Array
from kinfeas.io import strict_json
from kinfeas.io.files import write_file
from kinfeas.io.policy_metadata import Trained, read_trained
from kinfeas.policies import onnx_metadata
from kinfeas.policies.network import Network, read_network
from kinfeas.policies.onnx_file import TOLERANCE, PolicyFile, parse_policy_file
from kinfeas.policies.onnx_graph import BATCH, INPUT, IR_VERSION, OPSET, OUTPUT
from kinfeas.policies.onnx_metadata import About, Control, Golden
from kinfeas.robots.robot import Robot

if TYPE_CHECKING:
    import onnx

GOLDEN_PAIRS = 16
"""Pairs that a file carries along."""

PARITY_ROWS = 1000
"""Observations on which a file is compared with the training policy before it is handed out."""


def export(folder: Path, robot: Robot, out: Path) -> tuple[PolicyFile, float]:
    """Write the policy of a training run as one ONNX file and return it as it was read back.

    Args:
        folder: `runs/NAME`, whose best checkpoint is taken, or one checkpoint.
        robot: Whom it was trained for.
        out: The file; it appears complete or not at all.

    Returns:
        The policy, and the largest difference of its actions from the training policy's, which is
        at most `TOLERANCE`.

    Raises:
        KinfeasError: If there is no policy for this robot, the file cannot be written, or acts
            otherwise than the training policy.
    """
    network = read_network(folder, robot)
    content = to_onnx(network, describe(network, folder, robot))
    policy = parse_policy_file(content, robot)
    off = parity(network, policy)
    write_file(out, content)
    return policy, off


def describe(network: Network, folder: Path, robot: Robot) -> About:
    """Return what the policy's file is to say of itself.

    Args:
        network: The policy.
        folder: Where it was read from, beside what is known of its training.
        robot: Whom it drives.

    Raises:
        KinfeasError: If what is known of its training cannot be read.
    """
    trained = read_trained(folder)
    return About(
        version=__version__,
        robot=onnx_metadata.describe_robot(robot),
        observation=onnx_metadata.describe_observation(robot),
        action=onnx_metadata.describe_action(robot),
        control=Control(trained.period, HORIZON),
        training=_training(trained),
        success=_success(trained, folder),
        golden=golden_pairs(network),
    )


def golden_pairs(network: Network) -> Golden:
    """Return observations of all sizes, some of which are clipped, and the network's actions."""
    seen = np.round(_observations(network, GOLDEN_PAIRS, seed=0), 4)
    return Golden(
        tuple(map(tuple, seen.tolist())), tuple(map(tuple, np.round(network(seen), 7).tolist()))
    )


def parity(network: Network, policy: PolicyFile) -> float:
    """Return the largest difference between the actions of a file and of the training policy.

    Raises:
        KinfeasError: If it is more than `TOLERANCE`.
    """
    seen = _observations(network, PARITY_ROWS, seed=1)
    off = float(np.abs(policy(seen) - network(seen)).max())
    if not off <= TOLERANCE:
        raise KinfeasError(
            f"the exported policy acts otherwise than the training policy: {off:.2g} off, "
            f"where {TOLERANCE:g} is allowed"
        )
    return off


def to_onnx(network: Network, about: About) -> bytes:
    """Return an ONNX file of the network with its metadata and its digest.

    Raises:
        KinfeasError: If it does not pass ONNX's own checker.
    """
    import onnx

    sizes = len(network.scale), len(network.biases[-1])
    ends = [
        onnx.helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, [BATCH, size])
        for name, size in zip((INPUT, OUTPUT), sizes, strict=True)
    ]
    nodes, tensors = _graph(network)
    graph = onnx.helper.make_graph(nodes, "base_policy", ends[:1], ends[1:], tensors)
    model = onnx.helper.make_model(
        graph,
        opset_imports=[onnx.helper.make_opsetid("", OPSET)],
        ir_version=IR_VERSION,
        producer_name="kinfeas",
        producer_version=about.version,
    )
    onnx.helper.set_model_props(model, onnx_metadata.to_metadata(about))
    digest = onnx_metadata.digest(model.SerializeToString())
    model.metadata_props.add(key=onnx_metadata.DIGEST, value=digest)
    try:
        onnx.checker.check_model(model, full_check=True)
    except onnx.checker.ValidationError as error:
        raise KinfeasError(f"the exported policy is no valid ONNX model: {error}") from error
    return model.SerializeToString()


def _graph(network: Network) -> "tuple[list[onnx.NodeProto], list[onnx.TensorProto]]":
    """Return the nodes, one after the other, and the constants that they use."""
    from onnx import helper, numpy_helper

    bounds = np.float32(-CLIP), np.float32(CLIP)
    steps: list[tuple[str, dict[str, Any]]] = [("Mul", {"scale": network.scale})]
    steps.append(("Clip", dict(zip(("low", "high"), bounds, strict=True))))
    for i, (weight, bias) in enumerate(zip(network.weights, network.biases, strict=True)):
        steps += [("Gemm", {f"weight_{i}": weight, f"bias_{i}": bias}), ("Relu", {})]
    steps[-1] = ("Tanh", {})
    values = [INPUT, *(f"value_{i}" for i in range(len(steps) - 1)), OUTPUT]
    nodes, tensors = [], []
    for i, (operator, constants) in enumerate(steps):
        nodes.append(helper.make_node(operator, [values[i], *constants], [values[i + 1]]))
        for name, numbers in constants.items():
            array = np.ascontiguousarray(numbers, dtype=np.float32).reshape(np.shape(numbers))
            tensors.append(numpy_helper.from_array(array, name))
    return nodes, tensors


def _observations(network: Network, rows: int, seed: int) -> Array:
    """Return observations whose scaled numbers are normal draws: one in 370 is clipped."""
    draws = np.random.default_rng(seed).normal(size=(rows, len(network.scale)))
    return draws / network.scale


def _training(trained: Trained) -> dict[str, object]:
    """Return what is known of how a policy was trained, by name."""
    known = {
        "config": trained.config or None,
        "steps": trained.steps,
        "seed": trained.seed,
        "version": trained.version,
        "command": trained.command,
    }
    return {key: value for key, value in known.items() if value is not None}


def _success(trained: Trained, folder: Path) -> dict[str, object]:
    """Return the figures of a policy by kind: those of its run's `evaluation.json`, if there is.

    Figures of the episodes that picked it are left out, for they flatter it.
    """
    evaluation: dict[str, object] = dict(trained.fresh_evaluation)
    if (path := folder / "evaluation.json").exists():
        evaluation = strict_json.read(path)
        evaluation.pop("policy", None)  # a path of the run says nothing to whoever gets the file
    kinds = {"evaluation": evaluation, "benchmark": trained.benchmark}
    return {kind: figures for kind, figures in kinds.items() if figures}
