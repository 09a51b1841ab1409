"""`kinfeas deploy`: drive a robot, or what plays one, by a trained policy."""

import re
import sys
from contextlib import suppress
from dataclasses import asdict, replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from kinfeas.cli import completion, inputs, options
from kinfeas.cli.deploy_setup import (
    Four,
    Goal,
    Three,
    Wishes,
    drawn_scene,
    make_setup,
    make_task,
    read_settings,
)
from kinfeas.cli.output import check_outputs, print_table, status, write_json
from kinfeas.cli.policy_robot import robot_of
from kinfeas.core.errors import KinfeasError

if TYPE_CHECKING:
    from kinfeas.io.run_log import About
    from kinfeas.sim2real.deploy.deployment import Outcome, Setup
    from kinfeas.sim2real.deploy.rate import Timing


def deploy(  # noqa: PLR0913, PLR0917 - each option is an argument
    policy: Annotated[
        str,
        typer.Argument(
            help="ONNX file of kinfeas export, folder of a training run, pretrained, or a "
            "baseline such as follow_ee.",
            autocompletion=completion.policies,
        ),
    ],
    robot: options.PolicyRobotName = None,
    backend: Annotated[
        str,
        typer.Option(
            "--backend",
            help="What moves it: analytic, pybullet, ros2, ros1, or a plugin.",
            autocompletion=completion.plugins("backends"),
        ),
    ] = "pybullet",
    goal: Annotated[
        Three | None,
        typer.Option(
            "--goal",
            metavar="X Y Z",
            help="Where the EE frame, which the robot's YAML names, shall go, metres in the world: "
            "the frame that the backend measures the base in.",
        ),
    ] = None,
    rpy: Annotated[
        Three | None,
        typer.Option(
            "--rpy",
            metavar="R P Y",
            help="How it is turned there: roll, pitch and yaw about the world's axes, radians; by "
            "default as it is at the start.",
        ),
    ] = None,
    quaternion: Annotated[
        Four | None,
        typer.Option("--quaternion", metavar="X Y Z W", help="The same as a quaternion."),
    ] = None,
    generator: Annotated[
        str | None,
        typer.Option(
            "--generator",
            help="Motion generator to the goal, by name; by default linear.",
            autocompletion=completion.plugins("motion_generators"),
        ),
    ] = None,
    task: Annotated[
        str | None,
        typer.Option(
            "--task",
            help=f"Instead of --goal. {options.TASK_HELP}",
            autocompletion=completion.plugins("tasks"),
        ),
    ] = None,
    rate: Annotated[
        float, typer.Option("--rate", min=1.0, max=1000.0, help="Control periods a second, Hz.")
    ] = 50.0,
    seconds: Annotated[
        float, typer.Option("--seconds", min=0.0, help="Longest duration of the run, seconds.")
    ] = 300.0,
    seed: options.Seed = 0,
    record: Annotated[
        Path | None,
        typer.Option(
            "--record",
            metavar="FILE.csv",
            help="New file that the run is written to; by default "
            "DATE-ROBOT-TASK.csv in runs/deploy.",
        ),
    ] = None,
    sim2real: Annotated[
        str | None,
        typer.Option(
            "--adapters", help="Adapters around the backend: ideal, paper, pr2_like, harsh, a file."
        ),
    ] = None,
    guards: Annotated[
        Path | None, typer.Option("--guards", metavar="FILE", help="YAML of what the guards allow.")
    ] = None,
    real_time: Annotated[
        bool,
        typer.Option(
            "--real-time/--no-real-time",
            help="Whether a simulated world waits for the clock.",
        ),
    ] = True,
    filters: options.Filters = None,
    overrides: options.Overrides = None,
    json: options.JsonPath = None,
) -> None:
    """Drive a robot to a goal or through a task, behind guards, and record the run.

    Settings: [bold]guards.KEY[/], time_scale=1 (0.5 for pr2), head_start=0 s,
    arm_settle_timeout=8 s, filters (those of the robot), [bold]ik.KEY[/], and the parameters
    [bold]generator.KEY[/], [bold]task.KEY[/] and [bold]backend.KEY[/], which
    [bold]kinfeas plugins info NAME[/] lists. An
    unknown KEY is answered by those that there are.

    Guards: reach=true refuses a goal that no base pose is found for. The run is stopped beyond
    max_age=0.2 s of a measurement, max_period=0.2 s, max_clock_skew=0.1 s, max_distance=20 m,
    max_tilt=0.15 rad, pose_jump=0.3 m, heading_jump=0.5 rad, joint_tolerance=0.1 rad or m,
    max_consecutive_ik_failures=50 in a row, and watchdog=0.2 s without a sign of life. Commands are
    limited to max_linear_velocity (m/s), max_angular_velocity (rad/s), acceleration (m/s^2) and
    rotation_acceleration (rad/s^2), all four by default the robot's own, joint_speed=1 of the arm's
    own, joint_jump=3.2 rad or m, and max_tracking_delay=0.5 s.

    Exit codes: 0 the goal was reached, 2 the run could not begin, 3 a guard or an error stopped it,
    4 it was not over after --seconds, 130 Ctrl-C, 143 SIGTERM, 129 a terminal that was closed, 131
    SIGQUIT. In each case the base was commanded to zero.
    """
    options.check_robot(robot)
    from kinfeas.io.run_log import Recorder
    from kinfeas.sim2real.deploy.runtime import deploy as run

    read = {"--robot": robot, "--task": task, "--adapters": sim2real, "--guards": guards}
    sources = {option: inputs.named(name) for option, name in read.items()}
    sources |= {"POLICY": inputs.of_policy(policy), "--set": inputs.of_settings(overrides)}
    outputs = {"--record": record, "--json": json}
    check_outputs(outputs, sources)
    if robot is None:
        robot = robot_of(policy)
        check_outputs(outputs, {"POLICY": inputs.named(robot)})
    if record is not None and record.exists():
        raise KinfeasError(f"--record: {record} exists, and a record is never written over")
    wishes = Wishes(policy, robot, backend, sim2real, 1.0 / rate, seconds, seed, real_time)
    goal_wishes = Goal(task, generator, goal, rpy, quaternion)
    with status("getting ready"):
        known = options.read_robot(robot)
        config = read_settings(known, guards, options.with_filters(filters, overrides or [], ""))
        setup = make_setup(wishes, known, config, make_task(goal_wishes, config))
        about = replace(_about(wishes, setup), **drawn_scene(setup))
        recorder = Recorder(record or _record_path(about), about)
    with recorder:
        outcome = run(setup, recorder)
    with suppress(OSError):  # of a terminal that was closed
        _show(outcome, about, recorder.path)
        _complain(outcome)
    if json is not None:
        _write_json(outcome, recorder.path, json)
    raise typer.Exit(int(outcome.code))


def _complain(outcome: "Outcome") -> None:
    if outcome.code:
        sys.stderr.write(f"stopped: {outcome.reason}\n")
    if outcome.unstopped:
        sys.stderr.write(f"the base could not be commanded to zero: {outcome.unstopped}\n")
    if outcome.unclosed:
        sys.stderr.write(f"the backend could not be closed: {outcome.unclosed}\n")


def _about(wishes: Wishes, setup: "Setup") -> "About":
    from kinfeas.core.registry import from_anywhere
    from kinfeas.io.run_log import About

    return About(
        robot=from_anywhere(wishes.robot),
        task=setup.task.name,
        policy=wishes.policy,
        backend=wishes.backend,
        dt=wishes.dt,
        joints=tuple(joint.name for joint in setup.solver.robot.arm),
        started=datetime.now().astimezone().isoformat(timespec="seconds"),
    )


def _record_path(about: "About") -> Path:
    """Return where a run is recorded if the user does not say it."""
    from kinfeas.io.files import writing

    folder = Path("runs/deploy")
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    date = datetime.fromisoformat(about.started).strftime("%Y%m%d-%H%M%S")
    name = f"{date}-{_plain(Path(about.robot).stem)}-{_plain(about.task)}"
    names = (name, *(f"{name}-{number}" for number in range(2, 100)))  # begun in the same second
    paths = [folder / f"{one}.csv" for one in names]
    return next((path for path in paths if not path.exists()), paths[0])


def _plain(name: str) -> str:
    """Return a name as a part of a file's: what is no letter, digit, - or _ becomes _."""
    return re.sub(r"[^\w-]", "_", name)


def _write_json(outcome: "Outcome", record: Path, path: Path) -> None:
    """Write how a run ended; a failure changes nothing about that."""
    try:
        write_json({**asdict(outcome), "record": str(record)}, path)
    except KinfeasError as error:
        sys.stderr.write(f"--json: {error}\n")


def _work_rows(timing: "Timing") -> list[list[str]]:
    if timing.work_p50 is None or timing.work_p99 is None:
        return []
    return [
        ["work in a period, median", f"{1000.0 * timing.work_p50:.2f} ms"],
        ["work exceeded by one in a hundred", f"{1000.0 * timing.work_p99:.2f} ms"],
    ]


def _show(outcome: "Outcome", about: "About", record: Path) -> None:
    from kinfeas.benchmark.timing import peak_memory_mb
    from kinfeas.io.run_log import TASK_DONE

    timing = outcome.timing
    rows = [
        ["ended", outcome.reason + TASK_DONE[outcome.task_done]],
        ["duration", f"{outcome.seconds:.1f} s"],
        ["control periods without an IK solution", f"{outcome.failures}"],
        ["control period, median", f"{1000.0 * timing.p50:.1f} ms"],
        ["exceeded by one in a hundred", f"{1000.0 * timing.p99:.1f} ms"],
        ["longest", f"{1000.0 * timing.longest:.1f} ms"],
        ["missed deadlines", f"{timing.misses} of {timing.periods}"],
        *_work_rows(timing),
        ["most memory held", f"{peak_memory_mb():.0f} MB"],
        ["record", str(record)],
    ]
    title = f"{about.policy} on {about.task}, robot {about.robot}, {about.backend}"
    print_table(title, ["", ""], rows)
