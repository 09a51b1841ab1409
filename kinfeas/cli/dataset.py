"""`kinfeas dataset`: demonstrations and runs of servo as a LeRobot dataset, or as CSV files."""

from pathlib import Path
from typing import TYPE_CHECKING, Literal

from kinfeas.cli.options import argument, option
from kinfeas.cli.output import print_facts, status
from kinfeas.core.extras import require

if TYPE_CHECKING:
    from kinfeas.io.demonstrations import Demonstration


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
    from kinfeas.core.errors import KinfeasError
    from kinfeas.io.demonstrations import demonstration_files, write_demonstration
    from kinfeas.io.files import write_folder
    from kinfeas.io.lerobot import write_lerobot_dataset

    if kind == "lerobot":
        require("pyarrow")
    if out.exists():
        raise KinfeasError(f"{out}: exists")
    with status("converting"):
        files = [demonstration_files(source) if source.is_dir() else [source] for source in sources]
        motions = [_read(file) for some in files for file in some]
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
    """Return a demonstration, or the tool tip's motion in a record."""
    import numpy as np

    from kinfeas.control.execution import tool_pose
    from kinfeas.core import spatial
    from kinfeas.io.demonstrations import Demonstration, check_samples, read_demonstration
    from kinfeas.io.files import reading
    from kinfeas.io.run_log import is_record, read_record
    from kinfeas.kinematics.forward import forward
    from kinfeas.kinematics.ik import IkSolver
    from kinfeas.robots.loading import load_robot

    with reading(path):
        if not is_record(path):
            return read_demonstration(path)
    run = read_record(path)
    robot = load_robot(run.about.robot)
    base, joints = run.base_pose[run.later], run.joint_positions[run.later]
    ee = spatial.compose(base, forward(IkSolver(robot).chain, joints))
    tool = spatial.compose(ee, tool_pose(robot))
    time, goal = run.time[run.later], np.repeat(tool[-1:], len(tool), axis=0)
    check_samples(path, time, {"ee_pose": tool, "base_pose": base})
    return Demonstration(time, tool, base, goal)
