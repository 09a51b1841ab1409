"""Adapters: what stands between the loop and a backend, as a list in a YAML file."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

from kinfeas import config
from kinfeas.config import PluginSpec, strict_yaml
from kinfeas.config.recipes import find_recipe
from kinfeas.control.execution import ExecutionAdapter, ExecutionConfig
from kinfeas.core import registry
from kinfeas.core.backend import Backend, BackendWrapper
from kinfeas.core.checks.adapter import CheckedAdapter
from kinfeas.core.errors import KinfeasError
from kinfeas.core.plugin_errors import PluginErrors, is_own, package_of
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


@runtime_checkable
class Hooked(Protocol):
    """An adapter that can look at what its own hooks return."""

    def look_at_hooks(self, subject: str) -> None:
        """Look at it from now on; errors call the adapter `subject`."""
        ...


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
        KinfeasError: If there is no such adapter, or it refuses its parameters. Later, if one from
            outside raises, or returns what is malformed.
    """
    for adapter in adapters:
        given = {"backend": backend, "robot": robot}
        if clash := given.keys() & adapter.parameters.keys():
            raise KinfeasError(f"adapter {adapter.name!r} sets {', '.join(clash)} itself")
        given |= adapter.parameters
        made = registry.build("kinfeas.adapters", adapter.name, given)
        subject = f"adapter {adapter.name!r}"
        if isinstance(made, Hooked):
            made.look_at_hooks(subject)
        backend = (
            made
            if is_own(made) or isinstance(made, Hooked)
            else CheckedAdapter(made, subject, backend)
        )
    return backend


def chain(backend: Backend) -> Iterator[Backend]:
    """Yield `backend` and all that it is wrapped around, the outermost first."""
    link: Any = backend
    yield link
    while isinstance(link, BackendWrapper):
        if isinstance(link, CheckedAdapter):
            yield link.adapter
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
            with PluginErrors(f"{subject} fails in execution:", package_of(link)):
                answer: Any = link.execution(execution)
            if not isinstance(answer, ExecutionConfig):
                got = type(answer).__name__
                raise KinfeasError(
                    f"{subject} must return an ExecutionConfig from execution, not {got}"
                )
            execution = answer
    return execution
