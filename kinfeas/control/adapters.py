"""Adapters: what stands between the loop and a backend, as a list in a YAML file."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from kinfeas import config
from kinfeas.config import PluginSpec, strict_yaml
from kinfeas.config.recipes import find_recipe
from kinfeas.control.execution import ExecutionAdapter, ExecutionConfig
from kinfeas.core import registry
from kinfeas.core.backend import Backend, BackendWrapper
from kinfeas.core.errors import KinfeasError, plugin_note
from kinfeas.robots.robot import Robot

FOLDER = "sim2real"
"""Where the ladder of shipped lists stands among the configurations."""


@dataclass(frozen=True)
class Sim2Real:
    """What lies between the analytic world and a robot.

    Attributes:
        adapters: Wrapped around the backend, the first one innermost.
    """

    adapters: tuple[PluginSpec, ...] = ()


def read_sim2real(name: str) -> Sim2Real:
    """Return the list of adapters of a YAML file, or of one that comes with the package.

    Args:
        name: Path of the file, or `ideal`, `paper`, `pr2_like` or `harsh`.

    Raises:
        KinfeasError: If there is neither, or it is empty, or an entry of it is not allowed.
    """
    path = find_recipe(name, FOLDER)
    if not strict_yaml.read(path):
        raise KinfeasError(f"{path}: must hold a list 'adapters', which is [] for none")
    return config.load(Sim2Real, path)


def wrap(backend: Backend, adapters: Sequence[PluginSpec], robot: Robot) -> Backend:
    """Return `backend` within the adapters, the first one innermost.

    Args:
        backend: What carries out the commands in the end.
        adapters: What goes around it.
        robot: Whom it moves.

    Raises:
        KinfeasError: If there is no such adapter, or a parameter is invalid.
    """
    for adapter in adapters:
        given = {"backend": backend, "robot": robot}
        if clash := given.keys() & adapter.parameters.keys():
            raise KinfeasError(f"adapter {adapter.name!r} sets {', '.join(clash)} itself")
        backend = registry.build("kinfeas.adapters", adapter.name, given | adapter.parameters)
        if not isinstance(backend, BackendWrapper):
            raise KinfeasError(f"adapter {adapter.name!r} must derive from BackendWrapper")
    return backend


def chain(backend: Backend) -> Iterator[Backend]:
    """Yield `backend` and all that it is wrapped around, the outermost first."""
    link: Any = backend
    yield link
    while isinstance(link, BackendWrapper):
        link = link.backend
        yield link


def execution_of(backend: Backend, execution: ExecutionConfig) -> ExecutionConfig:
    """Return the pace that the adapters around a backend make of `execution`.

    Raises:
        KinfeasError: If one from outside fails, or makes no pace of it.
    """
    for link in chain(backend):
        if isinstance(link, ExecutionAdapter):
            subject = f"adapter {type(link).__name__}"
            with plugin_note(subject):
                answer: Any = link.execution(execution)
            if not isinstance(answer, ExecutionConfig):
                got = type(answer).__name__
                raise KinfeasError(
                    f"{subject} must return an ExecutionConfig from execution, not {got}"
                )
            execution = answer
    return execution
