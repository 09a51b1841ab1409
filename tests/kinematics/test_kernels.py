import ast
from pathlib import Path

import numpy as np
import pytest

import kinfeas
from kinfeas.kinematics.kernels import copy_row, square

KERNELS = {"kernel", "inlined", "compiled", "njit"}
SOURCES = sorted(Path(kinfeas.__file__).parent.rglob("*.py"))


def kernels():
    """The functions of the package that numba compiles, each with its module's name."""
    for path in SOURCES:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.FunctionDef):
                continue
            used = {name.id for one in node.decorator_list for name in ast.walk(one)
                    if isinstance(name, ast.Name)}  # fmt: skip
            if used & KERNELS:
                yield pytest.param(node, id=f"{path.stem}.{node.name}")


@pytest.mark.parametrize("kernel", list(kernels()))
def test_no_kernel_takes_powers_whose_bits_depend_on_what_was_compiled_before(kernel):
    assert not any(isinstance(node, ast.Pow) for node in ast.walk(kernel))


def test_there_are_kernels_to_look_at():
    assert len(list(kernels())) > 30


def test_square():
    assert square(-1.5) == 2.25
    assert square(3) == 9


def test_copies_a_row():
    out = np.zeros(3)
    copy_row(np.arange(3.0), out)
    np.testing.assert_array_equal(out, [0.0, 1.0, 2.0])
