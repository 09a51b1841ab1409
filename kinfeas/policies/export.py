"""Export of a trained policy as one ONNX file that describes itself."""

from pathlib import Path

import numpy as np
from pydantic_core import to_json

from kinfeas import __version__, config
from kinfeas.control.observation import CLIP, HORIZON, describe_action, describe_observation
from kinfeas.core.errors import KinfeasError
from kinfeas.core.files import read_json, write_file
from kinfeas.core.spatial import Array
from kinfeas.io.policy_metadata import Trained, read_trained
from kinfeas.policies import onnx_policy
from kinfeas.policies.network import Network, read_network
from kinfeas.robots.robot import Robot

GOLDEN_PAIRS = 16
"""Number of golden pairs in a file."""

OPSET, IR_VERSION = 14, 7
"""Versions of the operators and of the format, which onnxruntime supports since 1.8."""


def export(folder: Path, robot: Robot, out: Path) -> tuple[onnx_policy.OnnxPolicy, float]:
    """Write the policy of a run `runs/NAME` or of a checkpoint as an ONNX file.

    Returns:
        The policy read back from the file, and the largest difference between onnxruntime's actions
        and those of the trained network.

    Raises:
        KinfeasError: If there is no policy for this robot, the file cannot be written, or the
            difference exceeds `TOLERANCE`.
    """
    network, trained = read_network(folder, robot), read_trained(folder)
    names = ("config", "steps", "seed", "version", "command")
    training = {name: getattr(trained, name) for name in names}
    golden = np.round(_observations(network, GOLDEN_PAIRS, seed=0), 4)
    metadata = onnx_policy.PolicyMetadata(
        version=__version__,
        robot=onnx_policy.describe_robot(robot),
        observation=describe_observation(robot, network.observation_terms),
        action=(describe_action(robot),),
        control=onnx_policy.Control(trained.period, HORIZON),
        training={name: value for name, value in training.items() if value not in (None, {})},
        success=_success(trained, folder),
        golden=onnx_policy.GoldenPairs(
            *(tuple(map(tuple, rows.tolist())) for rows in (golden, np.round(network(golden), 7)))
        ),
    )
    content = to_onnx(network, metadata)
    observations = _observations(network, 1000, seed=1)
    deviation = float(np.abs(_run(content, observations) - network(observations)).max())
    if not deviation <= onnx_policy.TOLERANCE:
        raise KinfeasError(
            f"the exported policy deviates by {deviation:.2g}, above {onnx_policy.TOLERANCE:g}"
        )
    policy = onnx_policy.OnnxPolicy(content)
    write_file(out, content)
    return policy, deviation


def to_onnx(network: Network, metadata: onnx_policy.PolicyMetadata) -> bytes:
    """Return an ONNX file of a network with its metadata and digest."""
    import onnx
    from onnx import helper, numpy_helper

    constants = {"scale": network.scale, "low": -CLIP, "high": CLIP}
    for i, (weight, bias) in enumerate(zip(network.weights, network.biases, strict=True)):
        constants |= {f"weight_{i}": weight, f"bias_{i}": bias}
    nodes = [
        helper.make_node(operator, inputs, [output])
        for operator, inputs, output in onnx_policy.graph_nodes(len(network.weights))
    ]
    tensors = [
        numpy_helper.from_array(np.array(numbers, dtype=np.float32, order="C"), name)
        for name, numbers in constants.items()
    ]
    sizes = ((onnx_policy.INPUT, len(network.scale)), (onnx_policy.OUTPUT, len(network.biases[-1])))
    inputs, outputs = (
        [helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, [onnx_policy.BATCH, size])]
        for name, size in sizes
    )
    model = helper.make_model(
        helper.make_graph(nodes, "base_policy", inputs, outputs, tensors),
        opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR_VERSION,
        producer_name="kinfeas", producer_version=metadata.version,
    )  # fmt: skip
    entries = {"schema": onnx_policy.SCHEMA, **config.to_mapping(metadata)}
    # Strict JSON has no infinity.
    texts = {
        onnx_policy.PREFIX + key: to_json(value, inf_nan_mode="strings").decode()
        for key, value in entries.items()
    }
    helper.set_model_props(model, texts)
    onnx.checker.check_model(model, full_check=True)
    body = model.SerializeToString()
    return body + onnx_policy.digest_entry(body)


def _run(content: bytes, observations: Array) -> Array:
    import onnxruntime

    session = onnxruntime.InferenceSession(content, providers=["CPUExecutionProvider"])
    (actions,) = session.run(
        (onnx_policy.OUTPUT,), {onnx_policy.INPUT: observations.astype(np.float32)}
    )
    return np.asarray(actions)


def _observations(network: Network, rows: int, seed: int) -> Array:
    """Return observations whose scaled entries are normal draws, of which 1 in 370 is clipped."""
    draws = np.random.default_rng(seed).normal(size=(rows, len(network.scale)))
    return draws / network.scale


def _success(trained: Trained, folder: Path) -> dict[str, object]:
    # Metrics of the episodes that selected the checkpoint are biased and left out.
    evaluation: dict[str, object] = {}
    if trained.fresh_evaluation:
        world = trained.config.get("world")
        backend = world.get("backend") if isinstance(world, dict) else None
        where = {"task": trained.config.get("task"), "world": backend}
        evaluation = {**where, **trained.fresh_evaluation}
    if (path := folder / "evaluation.json").exists():
        evaluation = read_json(path)
        evaluation.pop("policy", None)  # a path of this machine
    return {"evaluation": evaluation} if evaluation else {}
