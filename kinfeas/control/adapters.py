"""Adapters around a backend, as a list in YAML."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from kinfeas import config
from kinfeas.config import PluginSpec
from kinfeas.config.recipes import find_recipe
from kinfeas.control.execution import ExecutionAdapter, ExecutionConfig
from kinfeas.core import registry
from kinfeas.core.backend import Backend, BackendWrapper
from kinfeas.core.errors import KinfeasError, plugin_note
from kinfeas.robots.robot import Robot

FOLDER = "sim2real"
"""Folder of the shipped lists of adapters."""


@dataclass(frozen=True)
class Sim2Real:
    """A list of adapters.

    Attributes:
        adapters: Adapters around the backend, the first one innermost.
    """

    adapters: tuple[PluginSpec, ...]


def read_sim2real(name: str) -> Sim2Real:
    """Return the adapters of a YAML file, or of a name in `configs/sim2real`."""
    return config.load(Sim2Real, find_recipe(name, FOLDER))


def with_adapters(backend: Backend, adapters: Sequence[PluginSpec], robot: Robot) -> Backend:
    """Return a backend within adapters, the first one innermost."""
    for adapter in adapters:
        given = {**adapter.parameters, "backend": backend, "robot": robot}
        backend = registry.build("kinfeas.adapters", adapter.name, given)
        if not isinstance(backend, BackendWrapper):
            raise KinfeasError(f"adapter {adapter.name!r} must derive from BackendWrapper")
    return backend


def chain(backend: Backend) -> Iterator[Backend]:
    """Yield a backend and the backends within it, the outermost first."""
    link: Any = backend
    yield link
    while isinstance(link, BackendWrapper):
        link = link.backend
        yield link


def execution_of(backend: Backend, execution: ExecutionConfig) -> ExecutionConfig:
    """Return `execution` as the adapters around a backend change it."""
    for link in chain(backend):
        if isinstance(link, ExecutionAdapter):
            with plugin_note(f"adapter {type(link).__name__}"):
                execution = link.execution(execution)
    return execution
