"""Imports point one way: each module may import lower layers only."""

import ast
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

# From the lowest to the highest. A set in a layer is one group: groups of one layer do not import
# each other, while the modules of a group may.
LAYERS = (
    (
        {
            "__init__",
            "spatial",
            "errors",
            "foreign",
            "storage",
            "schema",
            "config",
            "names",
            "quantities",
            "pose_kernels",
            "kernel_cache",
        },
    ),
    (
        {
            "robots",
            "motion",
            "single_motion",
            "conformance",
            "backend",
            "start",
            "pretrained",
            "demonstrations",
            "record",
            "rows",
        },
    ),
    (
        {
            "kinematics",
            "subgoals",
            "min_obstacle_distance",
            "motion sequence",
            "drive",
            "following",
            "half_spaces",
            "joints",
            "feasibility_filter",
            "observation",
            "trained",
            "policy",
            "registry",
            "adapters",
            "metrics",
            "templates",
            "testing",
        },
    ),
    ({"loop", "rollout_planner"}, {"plugins"}, {"scenes"}, {"tasks"}, {"baselines"}, {"draft"}),
    ({"envs"}, {"sim"}, {"sim2real"}),
    ({"training", "evaluation"},),
    ({"api", "cli", "__main__"},),
)
PLUGINS_MAY_REACH = 1

# A heavy or fragile library, and the only places that import it.
CONFINED = {
    "torch": ("kinfeas.training",),
    "stable_baselines3": ("kinfeas.training",),
    # `kinfeas speed` times PyBullet's and Pinocchio's IK beside ours.
    "pybullet": ("kinfeas.backends.pybullet", "kinfeas.benchmark.peers"),
    "pinocchio": ("kinfeas.benchmark.peers", "kinfeas.policies.baselines.whole_body_qp"),
    "pink": ("kinfeas.policies.baselines.whole_body_qp",),
    "sklearn": ("kinfeas.plugins.fit",),
    "onnx": ("kinfeas.sim2real.export",),
    "onnxruntime": ("kinfeas.policies.onnx_file",),
    "cyclonedds": ("kinfeas.sim2real.ros.ros2_bus", "kinfeas.sim2real.ros.ros2_messages"),
    "movement_primitives": ("kinfeas.plugins.forcing",),
    "trimesh": ("kinfeas.importer",),
    "viser": ("kinfeas.viz.pages.viser_server",),
}

# Where the packages lie in the tree; all others lie where their name says.
MOVED = ("plugins", "scenes", "sim2real", "configs")


def modules() -> dict[str, Path]:
    """Return the path of every module of the distribution, by its full name."""
    folders = [("kinfeas", ROOT / "kinfeas"), *((f"kinfeas.{name}", ROOT / name) for name in MOVED)]
    found = {}
    for package, folder in folders:
        for path in folder.rglob("*.py"):
            inner = path.relative_to(folder).with_suffix("").parts
            found[".".join((package, *inner)).removesuffix(".__init__")] = path
    return found


MODULES = modules()


@cache
def nodes(path: Path) -> tuple[ast.AST, ...]:
    """Return all that a module is made of."""
    return tuple(ast.walk(ast.parse(path.read_text())))


def imports(path: Path) -> Iterator[str]:
    """Yield the full names that a module imports, at the top or within a function."""
    for node in nodes(path):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}:{node.lineno}: a relative import"
            # `from kinfeas import config` imports a module, `from kinfeas.config import load` not.
            full = [f"{node.module}.{alias.name}" for alias in node.names]
            yield from (name if name in MODULES else node.module or "" for name in full)


def place(name: str) -> tuple[int, int]:
    """Return the layer of a module and its group within the layer."""
    part = name.split(".")[1] if "." in name else "__init__"
    for level, groups in enumerate(LAYERS):
        for number, group in enumerate(groups):
            if part in group:
                return level, number
    pytest.fail(f"{name} is in no layer: add it to LAYERS")


def within(name: str, packages: tuple[str, ...]) -> bool:
    return any(f"{name}.".startswith(f"{package}.") for package in packages)


CODE = sorted(name for name in MODULES if not within(name, ("kinfeas.configs",)))


@pytest.mark.parametrize("name", CODE)
def test_imports_lower_layers_only(name):
    level, group = place(name)
    for imported in imports(MODULES[name]):
        if not within(imported, ("kinfeas",)):
            continue
        its_level, its_group = place(imported)
        assert its_level < level or (its_level, its_group) == (level, group), (
            f"{name} (layer {level}) imports {imported} (layer {its_level})"
        )
        if within(name, ("kinfeas.plugins",)) and not within(imported, ("kinfeas.plugins",)):
            assert its_level <= PLUGINS_MAY_REACH, f"{name} imports {imported}"


@pytest.mark.parametrize("name", CODE)
def test_confined_libraries_stay_where_they_belong(name):
    for imported in imports(MODULES[name]):
        allowed = CONFINED.get(imported.split(".")[0])
        assert allowed is None or within(name, allowed), f"{name} imports {imported}"


@pytest.mark.parametrize("name", CODE)
def test_never_catches_every_exception(name):
    for node in nodes(MODULES[name]):
        if isinstance(node, ast.ExceptHandler):
            caught = ast.unparse(node.type) if node.type else "everything"
            assert caught not in {"everything", "Exception", "BaseException"}, node.lineno


def test_nothing_is_a_second_copy():
    for name, path in MODULES.items():
        for imported in imports(path):
            assert imported.split(".")[0] not in MOVED, f"{name} imports {imported}"


def test_every_package_is_in_the_wheel():
    listed = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"]
    present = {name for name, path in MODULES.items() if path.name == "__init__.py"}
    assert sorted(listed) == sorted(present)


def test_every_folder_with_modules_is_a_package():
    for path in MODULES.values():
        assert (path.parent / "__init__.py").exists(), f"{path.parent} lacks __init__.py"
