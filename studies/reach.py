"""Measure time and correctness of base poses for EE poses; write docs/figures/reach.json.

    python studies/reach.py --poses 10000

Pinocchio and FCL check each first base pose. Poses without one are compared with 4096 base poses.
Reasons are those of constructed cases. Times are CPU times of one core.
"""

import argparse
import json
import math
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import fcl
import numpy as np
import pinocchio
from scipy.spatial.transform import Rotation

from kinfeas.core.files import write_json
from kinfeas.core.metrics import GOAL_METRES, GOAL_RADIANS
from kinfeas.core.solids import Solids
from kinfeas.core.spatial import Array, make_pose, planar_pose, rotation
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolver, spread_configurations
from kinfeas.kinematics.self_collision import checked_links
from kinfeas.planning.placement import Postures, reachable
from kinfeas.planning.reach import BasePlacer
from kinfeas.robots.loading import load_robot
from kinfeas.robots.robot import Robot
from kinfeas.tasks.clutter import Clutter

ROBOTS = ("pr2", "tiago", "hsr")
TRIED = 4096  # base poses of the comparison
TIMED = 1000  # queries of each kind
CASES = 30  # constructed cases of solids; a third of these of other reasons
FAR = planar_pose(*np.array([[9.0], [9.0], [0.0]]))[0]  # start of the base, outside of solids


class Judge:
    """Kinematics of Pinocchio and collisions of FCL."""

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self.model = pinocchio.buildModelFromUrdf(str(robot.urdf_path))
        self.data = self.model.createData()
        kinds = {"box": fcl.Box, "cylinder": fcl.Cylinder, "sphere": fcl.Sphere}
        self.shapes = [
            (link.name, shape.pose, fcl.CollisionObject(kinds[shape.kind](*shape.size)))
            for link in robot.urdf.links.values() for shape in link.shapes
        ]  # fmt: skip
        checked = set(checked_links(robot))
        self.pairs = [
            (a, b) for (i, _, a), (j, _, b) in product(self.shapes, repeat=2) if (i, j) in checked
        ]

    def fault(self, goal: Array, base: Array, joints: Array, solids: Solids | None) -> str:
        """Return what is wrong with a base pose and an arm for an EE pose; empty if nothing is."""
        names = (joint.name for joint in self.robot.arm)
        positions = {**self.robot.fixed_joints, **dict(zip(names, joints.tolist(), strict=True))}
        q = pinocchio.neutral(self.model)
        for name, joint in self.robot.urdf.joints.items():
            if joint.moves:
                leader, scale, offset = self.robot.urdf.followed(joint)
                value = scale * positions[leader.name] + offset
                entry = self.model.joints[self.model.getJointId(name)]
                values = [math.cos(value), math.sin(value)] if entry.nq == 2 else [value]
                q[entry.idx_q : entry.idx_q + entry.nq] = values
        pinocchio.framesForwardKinematics(self.model, self.data, q)
        world = pinocchio.SE3(rotation(base).as_matrix(), base[:3])
        ee = world * self.data.oMf[self.model.getFrameId(self.robot.ee_frame)]
        turned = ee.rotation.T @ rotation(goal).as_matrix()
        errors = (
            np.linalg.norm(ee.translation - goal[:3]),
            np.linalg.norm(Rotation.from_matrix(turned).as_rotvec()),
        )
        tolerance = (
            (1e-4, 1e-3) if self.robot.pose_tolerance is None else (GOAL_METRES, GOAL_RADIANS)
        )
        if errors[0] > tolerance[0] + 1e-6 or errors[1] > tolerance[1] + 1e-6:
            return "pose"
        for link, pose, shape in self.shapes:
            placed = world * self.data.oMf[self.model.getFrameId(link)]
            placed *= pinocchio.SE3(rotation(pose).as_matrix(), pose[:3])
            shape.setTransform(fcl.Transform(placed.rotation, placed.translation))
        if any(touch(a, b) for a, b in self.pairs):
            return "self-collision"
        around = [] if solids is None else fcl_solids(solids)
        return "solids" if any(touch(s, o) for _, _, s in self.shapes for o in around) else ""


def touch(a: Any, b: Any) -> bool:
    """Return whether two objects of FCL touch."""
    return bool(fcl.collide(a, b, fcl.CollisionRequest(), fcl.CollisionResult()))


def fcl_solids(solids: Solids) -> list[Any]:
    """Return one row of solids for FCL."""
    objects = []
    for x, y, yaw, a, b, low, high, cylinder in solids.table[:, :8].tolist():
        shape = fcl.Cylinder(a, high - low) if cylinder else fcl.Box(2 * a, 2 * b, high - low)
        turn = Rotation.from_euler("z", yaw).as_matrix()
        objects.append(fcl.CollisionObject(shape, fcl.Transform(turn, [x, y, (low + high) / 2])))
    return objects


def draw_goals(robot: Robot, count: int, rng: np.random.Generator) -> Array:
    """Return EE poses of any orientation from 0.1 m below to above the heights of goals, (n, 7)."""
    low, high = robot.reach.low - 0.1, robot.reach.high + 0.1
    position = rng.uniform([-2.0, -2.0, low], [2.0, 2.0, high], (count, 3))
    return make_pose(position, Rotation.random(count, rng=rng))


def clutter(rng: np.random.Generator) -> Solids:
    """Return 32 solids on a floor of 8 m."""
    return Clutter().draw_solids(rng, np.zeros(2)).only(np.arange(32))


def times(placer: BasePlacer, among: bool) -> dict[str, object]:
    """Return milliseconds of queries that find a base pose, and of those that do not."""
    rng = np.random.default_rng(1)
    seconds: tuple[list[float], list[float]] = ([], [])
    for number, goal in enumerate(draw_goals(placer.solver.robot, TIMED + 20, rng)):
        solids = clutter(rng) if among else None
        begin = time.process_time()
        placement = placer.place(goal, solids)
        if number >= 20:
            seconds[not placement.reachable].append(time.process_time() - begin)
    found = 1e3 * np.array(seconds[0])
    return {
        "queries": len(found), "median_ms": round(float(np.median(found)), 2),
        "p99_ms": round(float(np.quantile(found, 0.99)), 2),
        "out_of_reach": len(seconds[1]),
        "out_of_reach_median_ms": round(1e3 * float(np.median(seconds[1])), 1),
    }  # fmt: skip


def answers(placer: BasePlacer, count: int) -> dict[str, object]:
    """Return how many answers are false, half of them among solids."""
    rng, judge, robot = np.random.default_rng(2), Judge(placer.solver.robot), placer.solver.robot
    faults, limits, missed, reached = Counter[str](), Counter[str](), 0, 0
    postures = Postures(placer.solver)
    for number, goal in enumerate(draw_goals(robot, count, rng)):
        solids = clutter(rng) if number % 2 else None
        placement = placer.place(goal, solids, FAR, count=1)
        limits[placement.limit] += 1
        if placement.reachable:
            reached += 1
            base, joints = placement.base_pose[0], placement.joint_positions[0]
            faults[judge.fault(goal, base, joints, solids)] += 1
            continue
        missed += len(postures.reaching(goal, (0, TRIED), solids, FAR)[0]) > 0
    del faults[""]
    return {
        "poses": count, "reachable": reached, "false_reachable": dict(faults),
        "false_unreachable": missed, "limits": dict(limits),
    }  # fmt: skip


def reasons(robot: Robot) -> dict[str, list[int]]:
    """Return for each reason how many constructed cases name it, and their number."""
    counts: dict[str, list[int]] = {}
    for reason, right in cases(robot, np.random.default_rng(3)):
        count = counts.setdefault(reason, [0, 0])
        count[0] += right
        count[1] += 1
    return counts


def cases(robot: Robot, rng: np.random.Generator) -> Iterator[tuple[str, bool]]:
    """Yield constructed reasons, and whether they are named."""
    placer = BasePlacer(robot)
    # EE poses beyond heights and joint limits, of arms that touch the robot, and for weak motors.
    strong = BasePlacer(replace(robot, max_gravity_load=None))
    weak = BasePlacer(replace(robot, max_gravity_load=0.1))
    joints = spread_configurations(robot, 20_000, seed=5)
    free, touching = forward(placer.solver.chain, joints), ~strong.solver.admissible(joints)
    low, high = free[:, 2].min() - 0.3, free[:, 2].max() + 0.3
    for height in np.concatenate(
        [rng.uniform(low - 1.0, low, 6), rng.uniform(high, high + 2.0, 6)]
    ):
        goal = make_pose(np.array([1.0, 1.0, height]), Rotation.random(rng=rng))
        yield "height", placer.place(goal).limit == ("height" if height >= 0.0 else "floor")
    drawn = iter(draw_goals(robot, 4000, rng))
    placed = (goal for goal in drawn if placer.place(goal).reachable)
    for kind, goal in zip(("top", "floor", "wall") * CASES, placed, strict=False):
        yield among_solids(placer, kind, goal, rng)
    middle = np.quantile(free[:, 2], [0.01, 0.99])
    levels = [goal for goal in draw_goals(robot, 4000, rng) if middle[0] < goal[2] < middle[1]]
    loose = IkSolver(strong.solver.robot, replace(strong.solver.options, self_collision=False))
    yield from unreached("orientation", levels, None, loose, strong)
    yield from unreached("self-collision", list(free[touching]), loose, strong.solver, strong)
    if weak.solver.gravity.limited:
        yield from unreached("torque", levels, strong.solver, weak.solver, weak)


def among_solids(
    placer: BasePlacer, kind: str, goal: Array, rng: np.random.Generator
) -> tuple[str, bool]:
    """Return the reason of a solid around a reachable pose, and whether it is named."""
    (x, y, z), others = goal[:3], clutter(rng).table
    others = others[np.hypot(others[:, 0] - x, others[:, 1] - y) > 2.5]
    lines = {
        "top": [[x, y, 0.3, 0.4, 0.4, z - 0.08, z + 0.08]],
        "floor": [[x, y, 0.0, 2.5, 2.5, 0.01, 0.2]],
        "wall": [[6.0, 0.0, 0.0, 0.05, 14.0, 0.0, 2.0]],
    }
    line = np.array([[*solid, *[0.0] * 4] for solid in lines[kind]])
    placement = placer.place(goal, Solids.from_table(np.vstack([others, line])), FAR)
    if kind == "wall":
        return "path", placement.limit == "path"
    return f"solids ({kind})", placement.limit == "solids" and placement.solids == (len(others),)


def unreached(
    reason: str, goals: list[Array], less: IkSolver | None, more: IkSolver, placer: BasePlacer
) -> Iterator[tuple[str, bool]]:
    """Yield whether a reason is named at poses that only a solver with fewer limits reaches."""
    count = 0
    for goal in goals[:4000]:
        if placer.place(goal, count=1).reachable or count == CASES // 3:
            continue
        stages = (TRIED,)
        if less is not None and not reachable(less, goal[np.newaxis], stages).reached[0]:
            continue
        if not reachable(more, goal[np.newaxis], stages).reached[0]:
            count += 1
            yield reason, placer.place(goal).limit == reason


def main() -> None:
    """Measure the robots and write the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--poses", type=int, default=10_000)
    parser.add_argument("--robots", nargs="*", default=ROBOTS)
    parser.add_argument("--out", type=Path, default=Path("docs/figures/reach.json"))
    options = parser.parse_args()
    figures = {}
    for name in options.robots:
        robot = load_robot(name)
        placer = BasePlacer(robot)
        figures[name] = {
            "empty_floor": times(placer, False), "32_solids": times(placer, True),
            "reasons": reasons(robot), "answers": answers(placer, options.poses),
        }  # fmt: skip
        print(name, json.dumps(figures[name]), flush=True)
    write_json(figures, options.out)


if __name__ == "__main__":
    main()
