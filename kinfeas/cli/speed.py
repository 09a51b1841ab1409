"""`kinfeas speed`: how fast everything is on this machine."""

from typing import TYPE_CHECKING, Annotated

import typer

from kinfeas.cli import inputs, options
from kinfeas.cli.output import check_outputs, print_table, share, status, write_json
from kinfeas.cli.policy_robot import check_policy, robot_of
from kinfeas.core.errors import KinfeasError

if TYPE_CHECKING:
    from kinfeas.policies.network import Network
    from kinfeas.robots.robot import Robot

PolicyFolder = Annotated[
    str | None,
    typer.Option(
        "--policy",
        help="Folder of a training run whose policy is timed; by default 256 x 256 random weights.",
    ),
]


def speed(
    robot: options.PolicyRobotName = None,
    policy: PolicyFolder = None,
    json: options.JsonPath = None,
) -> None:
    """Time inverse kinematics beside Pinocchio and PyBullet, environments, policy and training.

    One core each, the best of several repeats; training, by the robot's own recipe, takes all
    cores, half a minute long. Steps are control periods, also where an action holds for several.
    """
    options.check_robot(robot)
    if policy is not None:
        check_policy(policy)
    from kinfeas.benchmark.speed import Figure, measure_speed

    sources = {"--robot": inputs.named(robot), "--policy": inputs.of_policy(policy)}
    check_outputs({"--json": json}, sources)
    if robot is None:
        robot = robot_of(policy)
        check_outputs({"--json": json}, {"--policy": inputs.named(robot)})
    network = _read_policy(policy, options.read_robot(robot)) if policy is not None else None
    with status("speed") as show:
        figures = measure_speed(robot, network, on_part=lambda part: show(f"timing: {part}"))
    if json is not None:
        write_json({figure.key: figure.value for figure in figures if figure.key}, json)

    def text(figure: Figure) -> str:
        if figure.value is None:
            return "not installed"
        if not figure.unit:
            return share(figure.value)
        digits = 0 if figure.value >= 1000 else 2
        return f"{figure.value:,.{digits}f} {figure.unit}"

    rows = [[figure.text, text(figure)] for figure in figures]
    print_table(f"speed, robot {robot}", ["", " on this machine"], rows)


def _read_policy(folder: str, robot: "Robot") -> "Network":
    from kinfeas.policies.loading import load_policy
    from kinfeas.policies.network import Network

    network = load_policy(folder, robot)
    if not isinstance(network, Network):
        raise KinfeasError(
            f"--policy {folder}: speed times trained policies only; name a run folder"
        )
    return network
