"""Adapters: what stands between the loop and a backend, as a list in a YAML file."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

from kinfeas import config, registry
from kinfeas.backend import Backend
from kinfeas.legs import Pace, Pacing
from kinfeas.recipes import find_recipe
from kinfeas.robots.robot import Robot

FOLDER = "sim2real"
"""Where the ladder of shipped lists stands among the configurations."""


@dataclass(frozen=True)
class AdapterSpec:
    """An adapter by name.

    Attributes:
        name: Entry-point name in the group kinfeas.adapters.
        parameters: Its keyword parameters.
    """

    name: str
    parameters: dict[str, object] = field(default_factory=dict)


@dataclass(frozen=True)
class Sim2Real:
    """What lies between the analytic world and a robot.

    Attributes:
        adapters: Wrapped around the backend, the first one innermost.
    """

    adapters: tuple[AdapterSpec, ...] = ()


@runtime_checkable
class Wrapping(Protocol):
    """A backend around a backend."""

    backend: Backend


def read_sim2real(name: str) -> Sim2Real:
    """Return the list of adapters of a YAML file, or of one that comes with the package.

    Args:
        name: Path of the file, or `ideal`, `paper`, `pr2_like` or `harsh`.

    Raises:
        KinfeasError: If there is neither, or an entry of it is not allowed.
    """
    return config.load(Sim2Real, find_recipe(name, FOLDER, f"{FOLDER}/"))


def wrap(backend: Backend, adapters: Sequence[AdapterSpec], robot: Robot) -> Backend:
    """Return `backend` within the adapters, the first one innermost.

    Args:
        backend: What carries out the commands in the end.
        adapters: What goes around it.
        robot: Whom it moves.

    Raises:
        KinfeasError: If there is no such adapter, or it refuses its parameters.
    """
    for adapter in adapters:
        given = {"backend": backend, "robot": robot, **adapter.parameters}
        backend = registry.build("kinfeas.adapters", adapter.name, given)
    return backend


def chain(backend: Backend) -> Iterator[Backend]:
    """Yield `backend` and all that it is wrapped around, the outermost first."""
    yield backend
    while isinstance(backend, Wrapping):
        backend = backend.backend
        yield backend


def paced(backend: Backend, pace: Pace) -> Pace:
    """Return the pace that the adapters around a backend make of `pace`."""
    for link in chain(backend):
        if isinstance(link, Pacing):
            pace = link.pace(pace)
    return pace
