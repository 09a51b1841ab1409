"""Compute golden figures anew: `python -m tests.golden.renew PATTERN ...`, such as 'ik-*'."""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # as in the tests: sums depend on the threads

import hashlib
import json
import platform
import sys
from fnmatch import fnmatch
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import llvmlite.binding as llvm
import numpy as np

DATA = Path(__file__).parent / "data"
_MACHINE = "machine"
_PACKAGES = ("numpy", "scipy", "numba", "llvmlite", "torch", "onnxruntime", "pybullet")
_PACKAGES += ("python-fcl",)


def machine():
    """Return what the last bits of a figure depend on: processor, C library and versions."""
    features = llvm.get_host_cpu_features().flatten()
    return {
        "processor": llvm.get_host_cpu_name(),
        "features": hashlib.sha256(features.encode()).hexdigest()[:16],
        "libc": "-".join(platform.libc_ver()),
        "python": platform.python_version(),
        **{name: _version(name) for name in _PACKAGES},
    }


def path_of(name):
    """Return the file of a figure."""
    return DATA / f"{name}.npz"


def read(name):
    """Return the stored arrays of a figure by name, and the machine that wrote them."""
    with np.load(path_of(name)) as stored:
        figure = dict(stored)
    return figure, json.loads(str(figure.pop(_MACHINE)))


def write(name, figure):
    """Store a figure of this machine."""
    np.savez_compressed(path_of(name), **figure, **{_MACHINE: json.dumps(machine())})


def changes(old, new):
    """Return the names of the arrays that differ in the last bit, or are in one figure only."""
    same = {key for key in old.keys() & new.keys() if np.array_equal(old[key], new[key])}
    return sorted((old.keys() | new.keys()) - same)


def _version(package):
    try:
        return version(package)
    except PackageNotFoundError:
        return "none"


def _renew(patterns):
    from tests.golden.figures import FIGURES

    chosen = [name for name in FIGURES if any(fnmatch(name, pattern) for pattern in patterns)]
    if not chosen:
        sys.exit(f"no such figure; there are: {', '.join(FIGURES)}")
    for name in chosen:
        figure = FIGURES[name]()
        old = read(name)[0] if path_of(name).exists() else {}
        write(name, figure)
        sys.stdout.write(f"{name}: {', '.join(changes(old, figure)) or 'unchanged'}\n")


if __name__ == "__main__":
    _renew(sys.argv[1:])
