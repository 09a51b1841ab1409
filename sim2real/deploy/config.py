"""Settings of a deployment."""

from dataclasses import dataclass, field

from kinfeas.config import PluginSpec
from kinfeas.control.execution import ExecutionSettings
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
