"""The graph of a policy file: what the network computes, and nothing else.

observation -> Mul scale -> Clip -> Gemm -> Relu -> ... -> Gemm -> Tanh -> action
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from kinfeas.core.errors import KinfeasError
from kinfeas.policies.onnx_bytes import content, fields, messages, number, text

INPUT: Final = "observation"
OUTPUT: Final = "action"
BATCH: Final = "batch"
"""Names of the graph's input, of its output, and of the axis that may have any length."""

OPSET, IR_VERSION = 14, 7
"""Versions of the operators and of the format: read by onnxruntime from 1.8 on."""

OPERATORS: Final = ("Mul", "Clip", "Gemm", "Relu", "Tanh")

_FLOAT = 1
_MODEL = {1: "ir", 2: "producer", 3: "release", 4: "domain", 5: "version", 6: "doc", 7: "graph"}
_MODEL |= {8: "opset", 14: "metadata"}
_GRAPH = {1: "node", 2: "name", 5: "tensor", 10: "doc", 11: "input", 12: "output"}
_NODE = {1: "input", 2: "output", 3: "name", 4: "operator", 6: "doc", 7: "domain"}
_TENSOR = {1: "dims", 2: "type", 8: "name", 9: "raw"}


@dataclass(frozen=True)
class Node:
    """One operator of the graph and the names of what goes in and comes out."""

    operator: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]


def check_graph(model: bytes) -> tuple[int, int]:
    """Return how many numbers go in and come out of the perceptron that an ONNX file holds.

    Raises:
        KinfeasError: If it holds anything but such a perceptron of finite float32 numbers.
    """
    parts = fields(model, _MODEL, "model")
    _check_versions(parts["ir"], parts["opset"])
    graph = fields(content(parts["graph"], "the graph"), _GRAPH, "graph")
    tensors = dict(map(_tensor, messages(graph["tensor"], "a tensor")))
    if len(tensors) != len(graph["tensor"]):
        raise KinfeasError("broken ONNX file: two of its tensors have one name")
    nodes = [_node(part) for part in messages(graph["node"], "a node")]
    widths = _check_perceptron(nodes, tensors)
    for name, key, width in ((INPUT, "input", widths[0]), (OUTPUT, "output", widths[1])):
        _check_value(graph[key], name, width)
    return widths


def _check_versions(ir: list[int | bytes], opset: list[int | bytes]) -> None:
    names = {1: "domain", 2: "version"}
    imports = [fields(part, names, "operator set") for part in messages(opset, "operator set")]
    found = [(text(one["domain"], "domain"), number(one["version"], "version")) for one in imports]
    if found != [("", OPSET)] or number(ir, "the version of the format") != IR_VERSION:
        others = ", ".join(f"{domain or 'ai.onnx'!r} {version}" for domain, version in found)
        raise KinfeasError(
            f"its operators are those of {others or 'no set'}, format {number(ir, 'format')}, "
            f"where only ai.onnx {OPSET}, format {IR_VERSION}, is allowed"
        )


def _node(message: bytes) -> Node:
    # The name comes first: an operator that must not be there explains whatever else is odd.
    loose = fields(message, {**_NODE, 5: "attribute"}, "node")
    operator = text(loose["operator"], "an operator")
    domain = text(loose["domain"], "a domain")
    if operator not in OPERATORS or domain:
        full = f"{domain}.{operator}" if domain else operator
        raise KinfeasError(f"it uses the operator {full!r}; allowed are {', '.join(OPERATORS)}")
    fields(message, _NODE, "node")
    ends = [tuple(text([one], "a name") for one in loose[key]) for key in ("input", "output")]
    return Node(operator, ends[0], ends[1])


def _tensor(message: bytes) -> tuple[str, NDArray[np.float32]]:
    parts = fields(message, _TENSOR, "tensor")
    name = text(parts["name"], "a name")
    shape = [number([one], "a size") for one in parts["dims"]]
    raw = content(parts["raw"], "the numbers of a tensor")
    count = 1
    for size in shape:
        count *= size
    if (
        number(parts["type"], "a type") != _FLOAT
        or len(shape) > 2
        or len(raw) != 4 * count
        or not count
    ):
        raise KinfeasError(f"its tensor {name!r} does not hold float32 numbers as many as it says")
    values = np.frombuffer(raw, dtype="<f4").reshape(shape)
    if not np.isfinite(values).all():
        raise KinfeasError(f"its tensor {name!r} holds numbers that are not finite")
    return name, values


def _check_perceptron(
    nodes: list[Node], tensors: dict[str, NDArray[np.float32]]
) -> tuple[int, int]:
    """Return how many numbers go in and out of nodes that form one line."""
    layers = sum(node.operator == "Gemm" for node in nodes)
    wanted = ["Mul", "Clip", *["Gemm", "Relu"] * (layers - 1), "Gemm", "Tanh"]
    if [node.operator for node in nodes] != wanted:
        raise KinfeasError("its operators are not those of a perceptron")
    values = [INPUT, *(name for node in nodes for name in node.outputs)]
    constants = [name for node in nodes for name in node.inputs[1:]]
    lined = all(
        node.inputs[:1] == (before,) and node.outputs == (after,)
        for node, (before, after) in zip(nodes, pairwise(values), strict=False)
    )
    once = len({*values, *constants}) == len(values) + len(constants)
    if not lined or not once or values[-1] != OUTPUT or set(constants) != set(tensors):
        raise KinfeasError(f"its operators do not form one line from {INPUT!r} to {OUTPUT!r}")
    shapes = [[tensors[name].shape for name in node.inputs[1:]] for node in nodes]
    widths = [constant[-1][-1] for constant in shapes if constant and constant[-1]]
    if min(widths, default=0) < 1 or shapes != _shapes(widths):
        raise KinfeasError("the shapes of its weights do not fit each other")
    return widths[0], widths[-1]


def _shapes(widths: list[int]) -> list[list[tuple[int, ...]]]:
    """Return the shapes of the constants of each node, for values of these widths."""
    shapes: list[list[tuple[int, ...]]] = [[(widths[0],)], [(), ()]]
    for before, after in pairwise(widths):
        # Gemm with its weights and biases; what follows it has no constants.
        shapes += [[(before, after), (after,)], []]
    return shapes


def _check_value(values: list[int | bytes], name: str, width: int) -> None:
    """Check that the graph's input or output is float32 of shape (any, width)."""
    value = fields(content(values, name), {1: "name", 2: "type"}, "value")
    kind = fields(content(value["type"], name), {1: "tensor"}, "type of a value")
    tensor = fields(content(kind["tensor"], name), {1: "type", 2: "shape"}, "tensor type")
    shape = fields(content(tensor["shape"], name), {1: "dims"}, "shape")
    dims = [
        fields(one, {1: "value", 2: "name"}, "size") for one in messages(shape["dims"], "a size")
    ]
    sizes = [number(one["value"], "a size") for one in dims]
    if (
        text(value["name"], "a name") != name
        or number(tensor["type"], "a type") != _FLOAT
        or sizes != [0, width]
        or text(dims[0]["name"], "a size") != BATCH
    ):
        raise KinfeasError(f"{name!r} must be float32 of shape ({BATCH}, {width})")
