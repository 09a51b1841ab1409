"""`kinfeas fit` and `kinfeas dataset`: motions and datasets from demonstrations."""

from pathlib import Path
from typing import TYPE_CHECKING, Literal

import typer

from kinfeas.cli import options
from kinfeas.cli.options import argument, option
from kinfeas.cli.output import print_facts, status, write_json
from kinfeas.core.extras import require

if TYPE_CHECKING:
    from kinfeas.io.demonstrations import Demonstration


def fit(
    demonstrations: list[Path] = argument(..., "Folders of *.csv files, or such files."),
    out: Path = options.file_option(..., "Model to write.", ".yaml", ".yml"),
    kind: Literal["imitation", "gaussian_mixture"] = option("imitation", "Generator of the model."),
    components: int = option(8, "Number of Gaussians.", min=1, max=50),
    seed: options.Seed = 0,
    json: options.JsonPath = None,
) -> None:
    """Learn an EE motion from demonstrations.

    A demonstration is a CSV table with the columns time, ee_x, ee_y, ee_z, ee_qx, ee_qy, ee_qz,
    ee_qw and the same of base_ and object_: world poses in metres and unit quaternions. The motion
    is learned in the frame of the object at the start.

    Use the model in a task or a test as the parameter model: path/of/model.yaml of the motion
    generator --kind.

    Example: kinfeas fit demonstrations/door/open --out my_door.yaml
    """
    from kinfeas.api import fit as api

    with status("learning"):
        motion = api.fit(demonstrations, out, kind=kind, components=components, seed=seed)
    names = [Path(name).name for name in motion.names]
    facts = {
        "kind": kind,
        "demonstrations": len(names),
        "components": len(motion.model.components),
        "base": motion.model.has_base,
        "duration_s": motion.duration,
        "length_m": motion.length,
        "position_residual_m": list(motion.position_residual),
        "rotation_residual_rad": list(motion.rotation_residual),
        "sides": list(motion.sides),
        "without_base": [name for name, has in zip(names, motion.has_base, strict=True) if not has],
    }
    write_json(facts, json)
    print_facts(f"{kind} model in {out}", facts)
    if len(set(motion.position_residual)) == 1:
        _warn("one demonstration, or copies of one, give no variation of the motion")
    if motion.outliers:
        outliers = ", ".join(Path(name).name for name in motion.outliers)
        _warn(f"far from the others, which pulls the learned path there: {outliers}")
    if any(motion.has_base) and not all(motion.has_base):
        _warn("no base motion is learned, since some demonstrations have none: see without_base")
    if any(motion.sides):
        sides = list(zip(names, motion.sides, strict=True))
        left, right = (", ".join(name for name, side in sides if side == i) for i in (0, 1))
        _warn(
            "the demonstrations follow two paths, and the model is a path between them; "
            f"fit each group on its own: {left}; {right}"
        )


def _warn(text: str) -> None:
    typer.echo(f"warning: {text}", err=True)


def dataset(
    sources: list[Path] = argument(..., "Demonstrations, records, or folders of them."),
    out: Path = option(..., "New folder to write.", metavar="FOLDER"),
    kind: Literal["lerobot", "csv"] = option("lerobot", "LeRobot dataset v3.0, or CSV files."),
    task: str = option("Follow the motion.", "Instruction in words."),
    robot: str | None = option(None, "Type of the robot."),
    fps: int = option(30, "Frames per second.", min=1, max=1000),
) -> None:
    """Convert recorded motions for learning.

    Poses are those of the tool tip and of the base. The object of a record is the tool tip's last
    pose.

    Example: kinfeas dataset demonstrations --out datasets/reach --task "Reach the shelf."
    """
    from kinfeas.core.files import check_new, write_folder
    from kinfeas.io.demonstrations import demonstration_files, write_demonstration
    from kinfeas.io.lerobot import write_lerobot_dataset

    if kind == "lerobot":
        require("pyarrow")
    check_new(out)
    with status("converting"):
        motions = [_read(file) for source in sources for file in demonstration_files(source)]
        if kind == "lerobot":
            write_lerobot_dataset(motions, out, task, robot, fps)
        else:

            def fill(folder: Path) -> None:
                for number, motion in enumerate(motions, 1):
                    write_demonstration(motion, folder / f"{number:03}.csv")

            write_folder(out, fill)
    seconds = sum(float(motion.time[-1] - motion.time[0]) for motion in motions)
    print_facts(f"{kind} in {out}", {"motions": len(motions), "seconds": seconds})


def _read(path: Path) -> "Demonstration":
    """Return the demonstration in a file, or the tool tip's motion in the record of a run."""
    import numpy as np

    from kinfeas.control.execution import tool_pose
    from kinfeas.core import spatial
    from kinfeas.core.files import reading
    from kinfeas.io.demonstrations import Demonstration, check_samples, read_demonstration
    from kinfeas.io.run_log import is_record, read_record
    from kinfeas.kinematics.forward import build_chain, forward
    from kinfeas.robots.loading import load_robot

    with reading(path):
        if not is_record(path):
            return read_demonstration(path)
    run = read_record(path)
    robot = load_robot(run.about.robot)
    base, joints = run.base_pose[run.later], run.joint_positions[run.later]
    ee = spatial.compose(base, forward(build_chain(robot), joints))
    tool = spatial.compose(ee, tool_pose(robot))
    time, goal = run.time[run.later], np.repeat(tool[-1:], len(tool), axis=0)
    check_samples(path, time, {"ee_pose": tool, "base_pose": base})
    return Demonstration(time, tool, base, goal)
