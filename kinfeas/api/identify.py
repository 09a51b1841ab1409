"""Robots identified from records, and the runs that record them."""

from collections.abc import Callable
from dataclasses import asdict, replace
from datetime import datetime
from pathlib import Path

from kinfeas.api import DEFAULT_ROBOT, Name
from kinfeas.api.deploy import Deployment, recorded
from kinfeas.api.load import checked, load_robot, read_adapters
from kinfeas.config import Settings
from kinfeas.config.quantities import Seed
from kinfeas.config.recipes import load_section
from kinfeas.control.assemble import with_adapters
from kinfeas.core.backend import build_backend
from kinfeas.core.errors import KinfeasError
from kinfeas.kinematics.ik import IkSolver
from kinfeas.policies.loading import load_policy
from kinfeas.sim2real.deploy.config import DeployConfig
from kinfeas.sim2real.deploy.preflight import warm_up
from kinfeas.sim2real.deploy.runtime import Setup
from kinfeas.sim2real.identify.excitation import SECONDS, Excitation


def drive(  # noqa: PLR0913 - options of the command
    robot: Name = DEFAULT_ROBOT,
    *,
    backend: str = "analytic",
    record: Name | None = None,
    adapters: Name | None = None,
    rate: float = 50.0,
    seed: int = 0,
    real_time: bool = True,
    settings: Settings | None = None,
    on_start: Callable[[], None] = lambda: None,
) -> Deployment:
    """Drive the pattern of a minute from which a robot is identified, and return the run.

    The guards are those of `kinfeas.deploy`, and `settings` are values by key of `DeployConfig`.
    Adapters are part of a simulated robot here: they lie within the guards.

    Raises:
        KinfeasError: If an argument or a setting is invalid, or the run cannot start.
    """
    model, dt = load_robot(robot), 1.0 / rate
    config = load_section(DeployConfig, "deploy", model.folder, settings)
    if record is not None and Path(record).exists():
        raise KinfeasError(f"{record}: exists")
    around = read_adapters(adapters)
    solver, policy = IkSolver(model, config.ik), load_policy("stationary", model)
    excitation = Excitation(solver, dt)
    warm_up(solver, policy, excitation, dt, filters=[excitation])
    inner = build_backend(backend, config.backend, robot=model)
    if around and inner.real_time is not None:
        inner.close()
        raise KinfeasError(f"adapters are for simulated worlds, not for backend {backend!r}")
    execution = replace(config, filters=(), arm_settle_timeout=0.0)
    setup = Setup(
        solver=solver, policy=policy, task=excitation, backend=with_adapters(inner, around, model),
        dt=dt, seconds=SECONDS, seed=checked(Seed, seed, "seed"), execution=execution,
        filters=(excitation,), guards=config.guards, real_time=real_time,
    )  # fmt: skip
    on_start()
    return recorded(setup, str(robot), "stationary", backend, record, adapters=around)
