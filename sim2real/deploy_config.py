"""What can be set of a deployment, and the backend that it runs on."""

import inspect
from dataclasses import dataclass, field

from kinfeas import registry
from kinfeas.backend import Backend
from kinfeas.errors import KinfeasError
from kinfeas.kinematics.ik import IkOptions
from kinfeas.legs import PATIENCE_SECONDS, SETTLE_SECONDS, Pace
from kinfeas.quantities import Seconds, SlowDown
from kinfeas.sim2real.guard_config import Guards


@dataclass(frozen=True)
class DeployConfig:
    """What can be set of a deployment beside policy, robot, backend and goal.

    Attributes:
        slow_down: How many times longer than planned the EE motions last.
        head_start: Seconds that the EE stands still at first, while the base moves already.
        patience: Seconds for which motion and base wait at most for an arm that swings to another
            configuration.
        guards: When it is stopped.
        generator: Keyword parameters of the motion generator of a goal.
        task: Keyword parameters of the task.
        backend: Keyword parameters of the backend, beside those that every robot gives it.
        ik: How hard IK searches.
    """

    slow_down: SlowDown = 1.0
    head_start: Seconds = 0.0
    patience: Seconds = PATIENCE_SECONDS
    guards: Guards = field(default_factory=Guards)
    generator: dict[str, object] = field(default_factory=dict)
    task: dict[str, object] = field(default_factory=dict)
    backend: dict[str, object] = field(default_factory=dict)
    ik: IkOptions = field(default_factory=IkOptions)

    @property
    def pace(self) -> Pace:
        """How EE motions are carried out."""
        return Pace(self.slow_down, self.head_start, SETTLE_SECONDS, patience=self.patience)


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
