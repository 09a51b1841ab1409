"""The assembly of a loop: robot, solver, backend within adapters, filters, motions and policy."""

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial

from kinfeas import config
from kinfeas.config import PluginSpec, registry
from kinfeas.config.recipes import find_recipe
from kinfeas.control.execution import ExecutionConfig, SubgoalMotion
from kinfeas.control.loop import Loop
from kinfeas.control.observation import HORIZON
from kinfeas.control.period import CommandFilter
from kinfeas.control.sequence import MotionSequence
from kinfeas.control.targets import TargetStream
from kinfeas.core.backend import Backend, BackendWrapper, RealTimeBackend
from kinfeas.core.errors import KinfeasError
from kinfeas.core.policy import Policy
from kinfeas.kinematics.ik import IkSolver
from kinfeas.robots.robot import Robot


def assemble(  # noqa: PLR0913 - the parts of a loop
    solver: IkSolver,
    subgoals: Sequence[SubgoalMotion],
    backend: Backend,
    *,
    dt: float = HORIZON,
    execution: ExecutionConfig | None = None,
    adapters: Sequence[PluginSpec] = (),
    filters: Sequence[PluginSpec | CommandFilter] = (),
    stream: TargetStream | None = None,
    policy: Policy | None = None,
    executor: Executor | None = None,
) -> Loop:
    """Return a loop of n robots; call its `start` before anything else.

    Args:
        solver: IK of the robot.
        subgoals: Motions that every EE makes in sequence, at least one.
        backend: Moves the robots.
        dt: Control period in seconds.
        execution: Execution of motions, which adapters may change; as planned by default.
        adapters: Adapters around the backend, the first one innermost.
        filters: Change the policy's commands, in this order.
        stream: Targets that move, if there are any.
        policy: Commands the bases; without one each step needs an action.
        executor: Runs long planning beside the loop; by default the loop waits for it.

    Raises:
        KinfeasError: If an adapter or a filter cannot be built, or does not fit the others.
    """
    backend = with_adapters(backend, adapters, solver.robot)
    execution = backend.execution(execution or ExecutionConfig())
    response = execution.response or backend.response
    offered = {
        "solver": solver, "backend": backend, "dt": dt, "execution": execution, "stream": stream,
        "executor": executor, "response": response,
    }  # fmt: skip

    build = partial(registry.build, "kinfeas.filters", offered=offered)
    built = [
        build(entry.name, entry.parameters) if isinstance(entry, PluginSpec) else entry
        for entry in filters
    ]
    sequence = MotionSequence(subgoals, solver, dt, execution, backend.gripper, stream)
    loop = Loop(solver, sequence, backend, dt, execution, response, built, build)
    if policy is not None:
        loop.set_policy(policy)
    return loop


def with_adapters(backend: Backend, adapters: Sequence[PluginSpec], robot: Robot) -> Backend:
    """Return a backend within adapters, the first one innermost.

    Raises:
        KinfeasError: If an adapter cannot be built, or needs an ability that the backend lacks.
    """
    for adapter in adapters:
        offered = {"backend": backend, "robot": robot}
        backend = registry.build("kinfeas.adapters", adapter.name, adapter.parameters, offered)
        if not isinstance(backend, BackendWrapper):
            raise KinfeasError(f"adapter {adapter.name!r} must derive from BackendWrapper")
        needed = getattr(backend, "needs", "")
        if needed and getattr(backend, needed) is None:
            raise KinfeasError(
                f"adapter {adapter.name!r} needs a backend with {needed}; {backend.name} has none"
            )
    return backend


def build_backend(name: str, parameters: Mapping[str, object], **offered: object) -> Backend:
    """Return a backend by its entry point and the keyword parameters of its constructor.

    Objects of the run, such as `robot`, are `offered`: passed on if the constructor names them.

    Raises:
        KinfeasError: If the backend is unknown or derives from another class than `Backend`, or a
            parameter is wrong or offered by the run.
    """
    backend = registry.build("kinfeas.backends", name, parameters, offered)
    if not isinstance(backend, Backend):
        raise KinfeasError(f"backend {name!r} must derive from kinfeas.core.backend.Backend")
    return backend


def build_simulator(name: str, parameters: Mapping[str, object], **offered: object) -> Backend:
    """Return a simulated backend as `build_backend` does, for programs without safety guards.

    Raises:
        KinfeasError: Also if the backend moves a robot in real time; its class is not called.
    """
    factory = registry.load("kinfeas.backends", name)
    if not (isinstance(factory, type) and issubclass(factory, RealTimeBackend)):
        backend = build_backend(name, parameters, **offered)
        if backend.real_time is None:
            return backend
        backend.close()
    raise KinfeasError(f"backend {name!r} is for deployment; only simulators are possible here")


def respond_late(adapters: Sequence[PluginSpec]) -> bool:
    """Return whether any of these adapters makes robots respond later."""
    classes = (registry.load("kinfeas.adapters", adapter.name) for adapter in adapters)
    return any(getattr(adapter_class, "late", False) for adapter_class in classes)


FOLDER = "sim2real"  # folder of the shipped lists of adapters


@dataclass(frozen=True)
class Sim2Real:
    """A list of adapters."""

    adapters: tuple[PluginSpec, ...]  # around the backend, the first one innermost


def read_sim2real(name: str) -> Sim2Real:
    """Return the adapters of a YAML file, or of a name in `configs/sim2real`."""
    return config.load(Sim2Real, find_recipe(name, FOLDER))
