"""Replay recorded EE motions as relative chunks and print a table: `python studies/chunks.py`.

The motions are episodes of the task `joystick`, recorded at 10 Hz. A simulated policy sees the EE
every 0.8 s and 0.2 s later sends the next 16 recorded poses, relative to what it saw, with 6-D
rotations; the last chunk stays for 0.3 s from the observation. Jumps are periods without an IK
solution or with a joint beyond its speed. RMS deviations are those from the recorded pose at the
same time, and from the nearest one within a second. Good replays have no jump and at most 1 cm RMS
at the same time.
"""

import argparse

import numpy as np

from kinfeas.config import PluginSpec, registry
from kinfeas.control.assemble import assemble
from kinfeas.control.targets import TargetRules
from kinfeas.core import spatial
from kinfeas.core.spatial import Array
from kinfeas.core.start import Start
from kinfeas.envs.world import World, WorldConfig
from kinfeas.kinematics.ik import IkSolver
from kinfeas.policies.loading import load_policy
from kinfeas.robots.loading import load_robot
from kinfeas.sim2real.servo.controller import TargetController
from kinfeas.tasks.loading import load_task
from kinfeas.tasks.task import build_subgoals
from kinfeas.viz.replay import Recording, record_episodes

ROBOTS = {"pr2": "PR2", "tiago": "TIAGo", "hsr": "HSR", "lekiwi": "LeKiwi"}
SCALING = (PluginSpec("time_scaling"),)
ROWS = {
    "policy, `time_scaling`": ("pretrained", SCALING),
    "policy": ("pretrained", ()),
    "`whole_body_qp`, `time_scaling`": ("whole_body_qp", SCALING),
    "`whole_body_qp`": ("whole_body_qp", ()),
    "arm alone": ("stationary", ()),
}
DT = 0.02  # s
EVERY, INFERENCE, KEEP, LENGTH = 0.8, 0.2, 0.3, 16  # s, s, s, poses


def main() -> None:
    """Print a row for each robot and policy."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--motions", type=int, default=10)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--robots", nargs="*", default=ROBOTS)
    options = parser.parse_args()
    print("| | good, % | jumps | RMS, mm | RMS from path, mm |\n|---|---|---|---|---|")
    for name in options.robots:
        solver = IkSolver(load_robot(name))
        task = load_task("joystick", {"seconds": options.seconds})
        trained = (solver.robot.folder / "policies").is_dir()
        world = World(solver.robot, task, WorldConfig(filters=SCALING), options.motions)
        recorder = load_policy("pretrained" if trained else "whole_body_qp", solver.robot)
        motions = record_episodes(world, recorder, options.motions)
        for label, (policy, filters) in ROWS.items():
            if policy == "pretrained" and not trained:
                continue
            replays = [replay(solver, policy, filters, motion) for motion in motions]
            squares = np.array([np.mean(deviations**2, axis=0) for _, deviations in replays])
            jumps = np.array([count for count, _ in replays])
            good = 100.0 * np.mean((jumps == 0) & (squares[:, 0] <= 0.01**2))
            timed, path = 1e3 * np.sqrt(squares.mean(axis=0))
            cells = f"{good:.0f} | {jumps.sum()} | {timed:.1f} | {path:.1f}"
            print(f"| {ROBOTS[name]}, {label} | {cells} |", flush=True)


def replay(
    solver: IkSolver, policy: str, filters: tuple[PluginSpec, ...], motion: Recording
) -> tuple[int, Array]:
    """Return the jumps, and distances of the EE from the recorded one in metres, (periods, 2).

    The first distance is that at the same time, the second the smallest one within a second.
    """
    now = 0.0
    rules = TargetRules(timeout=0.5)
    controller = TargetController(solver.robot, rules, clock=lambda: now)
    loop = assemble(
        solver, build_subgoals(controller.subgoals),
        registry.build("kinfeas.backends", "analytic", {}), dt=DT,
        filters=(controller, *filters), stream=controller,
        policy=load_policy(policy, solver.robot),
    )  # fmt: skip
    start = Start(
        motion.base_pose[:1], motion.joint_positions[:1], spatial.IDENTITY[np.newaxis, np.newaxis]
    )
    loop.start(start, [np.random.default_rng(0)])
    jumps, deviations, sent, chunk = 0, [], -np.inf, None
    periods = round(motion.times[-1] / DT)
    moments = np.minimum(DT * np.arange(periods + 1), motion.times[-1])
    recorded = spatial.interpolated(moments, motion.times, motion.ee_pose)
    for period in range(periods):
        now = period * DT
        if now >= sent + EVERY - 1e-9:
            sent, first = now, np.searchsorted(motion.times, now + 1e-9)
            ahead = slice(first, first + LENGTH)
            observed = np.tile(loop.true_state[1][0], (len(motion.times[ahead]), 1))
            chunk = motion.times[ahead], spatial.relative(motion.ee_pose[ahead], observed)
        if chunk is not None and now >= sent + INFERENCE - 1e-9:
            times, poses = chunk
            columns = spatial.rotation(poses).as_matrix()[:, :, :2].transpose(0, 2, 1)
            poses = np.concatenate([poses[:, :3], columns.reshape(-1, 6)], axis=1)
            controller.set_chunk(poses, times, relative=True, observed=sent, keep=KEEP)
            chunk = None
        now += DT
        outcome = loop.step()
        jumps += int(outcome.joint_jump[0] or not outcome.feasible[0])
        distances = spatial.distance(loop.true_state[1], recorded)[0]
        nearest = distances[max(0, period - 50) : period + 52].min()
        deviations.append((distances[period + 1], nearest))
    return jumps, np.array(deviations)


if __name__ == "__main__":
    main()
