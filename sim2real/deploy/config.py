"""What can be set of a deployment, and the backend that it runs on."""

import inspect
from dataclasses import dataclass, field

from kinfeas.config import PluginSpec
from kinfeas.control.execution import ExecutionSettings
from kinfeas.core import registry
from kinfeas.core.backend import Backend
from kinfeas.core.errors import KinfeasError
from kinfeas.kinematics.ik import IkOptions
from kinfeas.sim2real.deploy.guard_config import Guards


@dataclass(frozen=True)
class DeployConfig(ExecutionSettings):
    """What can be set of a deployment beside policy, robot, backend, goal and its pace.

    Attributes:
        guards: When it is stopped.
        generator: Keyword parameters of the motion generator of a goal.
        task: Keyword parameters of the task.
        backend: Keyword parameters of the backend, beside those that every robot gives it.
        ik: How hard IK searches.
        filters: Change the policy's commands, in this order.
    """

    guards: Guards = field(default_factory=Guards)
    generator: dict[str, object] = field(default_factory=dict)
    task: dict[str, object] = field(default_factory=dict)
    backend: dict[str, object] = field(default_factory=dict)
    ik: IkOptions = field(default_factory=IkOptions)
    filters: tuple[PluginSpec, ...] = ()


def build_backend(name: str, parameters: dict[str, object], **offered: object) -> Backend:
    """Return the backend of an entry point.

    Args:
        name: Entry point in the group kinfeas.backends.
        parameters: What the user says of it.
        offered: What is known besides, such as `robot`; the backend is given what it asks for by
            the names of its parameters.

    Raises:
        KinfeasError: If there is no such backend, or it refuses a parameter, or the user says
            what is offered.
    """
    factory = registry.load("kinfeas.backends", name)
    known = inspect.signature(factory).parameters if callable(factory) else {}
    given = {key: value for key, value in offered.items() if key in known}
    for key in given.keys() & parameters.keys():
        raise KinfeasError(f"backend {name!r}: the parameter {key!r} follows from the run")
    backend: Backend = registry.build("kinfeas.backends", name, {**given, **parameters})
    return backend
