"""Runs whose EE targets arrive while the robot moves."""

import logging
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from kinfeas.api import Name
from kinfeas.api.deploy import Deployment, make_setup, new_record, read_config, recorded
from kinfeas.api.load import load_robot, read_adapters, robot_of
from kinfeas.config import Settings
from kinfeas.config.recipes import default_engine
from kinfeas.core import registry
from kinfeas.core.errors import PLUGIN_ERRORS, describe, plugin_note
from kinfeas.sim2real.deploy.config import ServoConfig
from kinfeas.sim2real.deploy.runtime import Code
from kinfeas.sim2real.servo.controller import ServoTask, TargetController, TargetSource
from kinfeas.tasks.task import MotionSpec

GROUP = "kinfeas.target_sources"
_log = logging.getLogger(__name__)


def servo(  # noqa: PLR0913 - options of the command
    policy: Name = "pretrained",
    *,
    robot: Name | None = None,
    backend: str | None = None,
    source: str | TargetSource = "ros2",
    rate: float = 50.0,
    seconds: float = 3600.0,
    record: Name | None = None,
    adapters: Name | None = None,
    guards: Name | None = None,
    filters: str | Sequence[str] | None = None,
    settings: Settings | None = None,
    on_start: Callable[[], None] = lambda: None,
) -> Deployment:
    """Let base and arm follow EE targets, and return the result; the base is stopped at the end.

    Example: `kinfeas.servo(robot="pr2", backend="ros2", source=MySource()).targets`

    Arguments are the options of the command; `source` may also be a `TargetSource` of the calling
    program. `settings` are values by key of `ServoConfig`. `on_start` is called when all parts are
    prepared.

    Raises:
        KinfeasError: If an argument or a setting is invalid, or the run cannot start.
    """
    path = new_record(record)
    robot = robot or robot_of(policy)
    model = load_robot(robot)
    config = read_config(ServoConfig, "servo", model, guards, filters, settings)
    controller = TargetController(model, config.rules)
    limits = {**config.rules.generator_limits, **config.generator}
    task = ServoTask(controller, MotionSpec("servo", limits))
    name = f"target source {source if isinstance(source, str) else type(source).__name__!r}"
    targets = _build_source(source, config.source) if isinstance(source, str) else source
    backend = backend or default_engine()
    setup = make_setup(
        str(policy), model, backend, task, config, adapters=read_adapters(adapters),
        dt=1.0 / rate, seconds=seconds, seed=0, real_time=True,
    )  # fmt: skip
    setup = replace(setup, filters=(controller, *setup.filters))
    on_start()
    unclosed = ""
    with _watched(name, controller):
        try:
            with plugin_note(name):
                targets.start(controller)
            done = recorded(setup, str(robot), str(policy), backend, path, controller.statistics)
        finally:
            try:
                targets.close()
            except PLUGIN_ERRORS as error:
                unclosed = f"{name}: {describe(error)}"
                _log.error("could not be closed: %s", unclosed)
    if not unclosed:
        return done
    outcome = replace(done.outcome, code=done.outcome.code or Code.FAULT, unclosed=unclosed)
    return replace(done, outcome=outcome)


@contextmanager
def _watched(name: str, controller: TargetController) -> Iterator[None]:
    """End the run of a controller if a thread that starts meanwhile raises an exception."""
    others, hook = set(threading.enumerate()), threading.excepthook

    def failed(arguments: threading.ExceptHookArgs) -> None:
        hook(arguments)
        if arguments.thread not in others:
            raised = f"{arguments.exc_type.__name__}: {arguments.exc_value}"
            controller.fail(f"a thread of {name} raised {raised}")

    threading.excepthook = failed
    try:
        yield
    finally:
        threading.excepthook = hook


def _build_source(name: str, parameters: dict[str, object]) -> TargetSource:
    """Return a source by its entry point or as `module:Class`, also of the working directory."""
    if ":" not in name:
        return registry.build(GROUP, name, parameters)
    sys.path.append(str(Path.cwd()))
    return registry.build_target(GROUP, name, parameters)
