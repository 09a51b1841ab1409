"""Exported policies, and what can be done to their files."""

import json

import onnx

from kinfeas.policies.export import export
from kinfeas.policies.network import write_network
from kinfeas.policies.onnx_policy import digest_entry
from tests.builders import random_network

TRAINED = {
    "config": {"robot": "pr2", "task": "ggr", "world": {"dt": 0.1}},
    "steps": 1000,
    "evaluation": {"episodes": 256, "success": 1.0},
    "fresh_evaluation": {"episodes": 256, "success": 0.9},
}
"""What a run's `policy.json` tells of its training."""


def write_run(robot, folder, net_arch=8, extra=None):
    folder.mkdir(parents=True, exist_ok=True)
    network = random_network(robot, net_arch)
    write_network(network, folder, robot, TRAINED if extra is None else extra)
    return network


def write_policy_file(robot, folder, net_arch=8):
    """Export an untrained policy; return the training policy and the path of the file."""
    network = write_run(robot, folder / "run", net_arch)
    export(folder / "run", robot, folder / "policy.onnx")
    return network, folder / "policy.onnx"


def change(path, edit, sign=True):
    """Let `edit` change the ONNX model in a file; `sign` renews its digest."""
    model = onnx.load(path)
    edit(model)
    if sign:
        (old,) = (one for one in model.metadata_props if one.key == "kinfeas.digest")
        model.metadata_props.remove(old)
    body = model.SerializeToString()
    path.write_bytes(body + digest_entry(body) if sign else body)


def set_entry(model, key, value):
    for entry in model.metadata_props:
        if entry.key == f"kinfeas.{key}":
            entry.value = json.dumps(value)


def get_entry(model, key):
    (text,) = (one.value for one in model.metadata_props if one.key == f"kinfeas.{key}")
    return json.loads(text)
