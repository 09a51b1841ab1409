"""Runs that follow EE targets, which other programs send while the robot moves."""

import logging
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace

from kinfeas.api import Name
from kinfeas.api.deploy import Deployment, make_setup, read_config, recorded
from kinfeas.api.load import Adapters, load_robot, read_adapters, robot_of, text_of
from kinfeas.config import Settings, registry
from kinfeas.config.recipes import default_engine
from kinfeas.core.backend import closed_on_error
from kinfeas.core.errors import PLUGIN_ERRORS, KinfeasError, describe, plugin_note
from kinfeas.io.run_log import Moment
from kinfeas.sim2real.deploy.config import ServoConfig
from kinfeas.sim2real.deploy.runtime import Code
from kinfeas.sim2real.servo.controller import TargetController, TargetSource
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
    adapters: Adapters | None = None,
    guards: Name | None = None,
    filters: str | Sequence[str] | None = None,
    settings: Settings | None = None,
    on_moment: Callable[[Moment], None] | None = None,
) -> Deployment:
    """Let base and arm follow EE targets, and return the result; the base is stopped at the end.

    Example: `kinfeas.servo(robot="pr2", backend="ros2", source=MySource()).targets`

    Args:
        policy: Name, run folder, ONNX file, or `module:Class`.
        robot: Name or folder; by default the robot of the policy.
        backend: As in `deploy`.
        source: `ros2`, `ros1`, `module:Class`, a plugin, or a `TargetSource` object.
        rate: Control rate, Hz.
        seconds: Duration, seconds.
        record: New CSV file; by default one in `runs/deploy`.
        adapters: Name or YAML file of a list of adapters, or its entries.
        guards: YAML file with the limits of the guards.
        filters: Names of command filters; the robot's by default.
        settings: Values by key of `ServoConfig`, such as `rules.KEY` or `source.KEY`.
        on_moment: Called with each line of the record.

    Returns:
        A `Deployment`, whose `outcome.code` is 0 when `seconds` are over, and otherwise as in
        `deploy`; `targets` has the numbers of messages.

    Raises:
        KinfeasError: If an argument or a setting is invalid, or the run cannot start.
    """
    robot = robot or robot_of(policy)
    model = load_robot(robot)
    config = read_config(ServoConfig, "servo", model, guards, filters, settings)
    if config.task:
        raise KinfeasError("'task' has no effect, since targets come from the 'source'")
    limits = {**config.rules.generator_limits, **config.generator}
    controller = TargetController(model, config.rules, motion=MotionSpec("servo", limits))
    if isinstance(source, str):
        name, targets = f"target source {source!r}", registry.build(GROUP, source, config.source)
    else:
        if config.source:
            raise KinfeasError("'source' is an object, which takes no settings source.KEY")
        name, targets = f"target source {type(source).__name__!r}", source
        methods = (getattr(source, method, None) for method in ("start", "close"))
        if isinstance(source, type) or not all(map(callable, methods)):
            raise KinfeasError(
                f"'source' must be a name or an object with start and close, not {source!r}"
            )
    backend = backend or default_engine()
    setup = make_setup(
        policy, model, backend, controller, config, record, adapters=read_adapters(adapters),
        rate=rate, seconds=seconds, leading=(controller,),
    )  # fmt: skip
    unclosed = ""
    with _watched(name, controller):
        try:
            with plugin_note(name), closed_on_error(setup.backend):
                targets.start(controller)
            done = recorded(setup, text_of(robot, "robot"), str(policy), backend, record, on_moment)
        finally:
            try:
                targets.close()
            except PLUGIN_ERRORS as error:
                unclosed = f"{name}: {describe(error)}"
                _log.error("could not be closed: %s", unclosed)
    outcome = done.outcome
    if unclosed:
        outcome = replace(outcome, code=outcome.code or Code.FAULT, unclosed=unclosed)
    if controller.hint:
        _log.warning("%s", controller.hint)
    if outcome.code is Code.REACHED and (refusal := controller.refusal):
        outcome = replace(outcome, code=Code.TIME_OVER, reason=refusal)
    return replace(done, outcome=outcome, targets={"messages": controller.counts})


@contextmanager
def _watched(name: str, controller: TargetController) -> Iterator[None]:
    """End a controller's run if a thread that was started in the block raises an exception."""
    before, hook = set(threading.enumerate()), threading.excepthook

    def failed(arguments: threading.ExceptHookArgs) -> None:
        hook(arguments)
        if arguments.thread not in before:
            raised = f"{arguments.exc_type.__name__}: {arguments.exc_value}"
            controller.fail(f"a thread of {name} raised {raised}")

    threading.excepthook = failed
    try:
        yield
    finally:
        threading.excepthook = hook
