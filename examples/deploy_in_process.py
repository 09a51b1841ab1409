"""Deploy a policy from Python with an adapter, guards and a record of the run."""

import argparse
import tempfile
from pathlib import Path

import numpy as np

from kinfeas.config import PluginSpec, registry
from kinfeas.io.run_log import About, Recorder, read_record
from kinfeas.kinematics.ik import IkSolver
from kinfeas.policies.loading import load_policy
from kinfeas.robots.loading import load_robot
from kinfeas.sim2real.deploy.runtime import Setup, deploy
from kinfeas.sim2real.deploy.start import make_goal_task, warm_up
from kinfeas.tasks.task import MotionSpec


def main() -> None:
    """Reach a goal with base noise, then read the record."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=20.0)
    options = parser.parse_args()

    robot = load_robot("pr2")
    solver, dt = IkSolver(robot), 0.02
    noise = PluginSpec("base_noise", {"linear": 0.015, "angular": 0.015})
    policy = load_policy("pretrained", robot)
    task = make_goal_task((1.0, 0.5, 0.8), None, MotionSpec("minimum_jerk"))
    warm_up(solver, policy, task, dt, [noise])
    setup = Setup(
        solver=solver,
        policy=policy,
        task=task,
        backend=registry.build("kinfeas.backends", "analytic", {}),
        dt=dt,
        adapters=(noise,),
        seconds=options.seconds,
        real_time=False,
    )
    joints = tuple(joint.name for joint in robot.arm)
    about = About("pr2", "goal", "pretrained", "analytic", dt, joints, "2026-01-01T00:00:00Z")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.csv"
        with Recorder(path, about) as recorder:
            outcome = deploy(setup, recorder)
        record = read_record(path)
    print(f"{outcome.code.name}: {outcome.reason}, {outcome.failures} failures")
    displacement = np.linalg.norm(record.base_pose[-1, :2] - record.base_pose[0, :2])
    print(f"{len(record.time)} lines recorded, base displacement {displacement:.2f} m")


if __name__ == "__main__":
    main()
