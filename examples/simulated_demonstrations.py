"""Write demonstrations of a simulated hand that grasps a handle and opens the door or the drawer.

The shipped motions (`plugins/models`) are fitted to 12 of them with seed 0: docs/demonstrations.md.
"""

import argparse
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from kinfeas.core.spatial import compose, make_pose, planar_pose, rotation
from kinfeas.io.demonstrations import Demonstration, write_demonstration
from kinfeas.scenes.scene import read_scene

RATE, SUBSTEPS, DURATION = 50.0, 10, (2.0, 5.0)  # Hz, simulation steps in a sample, s of a motion
ROLL = {"door": 0.0, "drawer": -np.pi / 2}  # rad about the approach: fingers across the bar
START = {"door": [-0.24, 0.0, 0.0], "drawer": [-0.1, 0.0, 0.04]}  # m, tool tip in the handle frame
OPENING, RISE = {"door": 1.6755, "drawer": 0.24}, {"door": 0.0, "drawer": 0.02}  # rad or m, m
INERTIA = {"door": 0.02563, "drawer": 0.4}  # kg m^2 about the hinge, kg
DRIFT, HAND_ERROR, TURN_ERROR, START_ERROR = 0.0025, 0.015, 0.1396, 0.02  # RMS: m, m, rad, m
SLIP = 0.15  # fraction of the handle's rotation that the wrist does not make
ARM_LENGTH, STAND_ERROR, BASE_FRACTION = 0.75, 0.03, 0.935  # m, m, base path / EE path
MASS, ARM_STIFFNESS, GRIP_STIFFNESS = 1.0, 600.0, 2500.0  # kg, N/m, N/m
ALL, NOT_FINGERS, PLANE = np.ones(3), np.array([1.0, 0.0, 1.0]), np.array([1.0, 1.0, 0.0])


class Mechanism:
    """The hinge or slide of a handle in the shipped room."""

    def __init__(self, name):
        room = read_scene("room")
        furniture = room.objects[room.handles[name].object]
        self.joint = furniture.urdf.joints[room.handles[name].joint]
        frame = furniture.link_poses()[self.joint.child]
        self.handle, self.inertia = room.handle_pose(name), INERTIA[name]
        self.origin, self.axis = frame[:3], rotation(frame).apply(self.joint.axis)
        self.slides = self.joint.kind == "prismatic"

    def carry(self, point, position, origin_error=0.0):
        """Return a `point` (3,) of the closed mechanism at joint `position` (...), (..., 3)."""
        along = np.asarray(position)[..., np.newaxis] * self.axis
        if self.slides:
            return point + along
        origin = self.origin + origin_error
        return origin + Rotation.from_rotvec(along).apply(point - origin)

    def step(self, position, velocity, force, point, dt):
        """Return position and velocity after `force` acted at `point` for `dt` seconds."""
        effort = self.axis @ (force if self.slides else np.cross(point - self.origin, force))
        velocity += dt / self.inertia * (effort - self.joint.damping * velocity)
        lost = min(abs(velocity), dt * self.joint.friction / self.inertia)
        velocity -= np.copysign(lost, velocity)
        free = position + dt * velocity
        position = min(max(free, self.joint.lower), self.joint.upper)
        return position, velocity if position == free else 0.0


def minimum_jerk(time):
    """Return the completed fraction of the path at each of `time` (t,) (Flash and Hogan 1985)."""
    progress = time / time[-1]
    return progress**3 * (10.0 + progress * (6.0 * progress - 15.0))


def scatter(rng, size, mask):
    """Return a normally distributed vector of RMS `size`, at most twice it; `mask` selects axes."""
    drawn = rng.normal(size=3) * mask * size / np.sqrt(np.sum(mask))
    return drawn * min(1.0, 2.0 * size / np.linalg.norm(drawn))


def drift(rng, time):
    """Return slow random motion of RMS `DRIFT`, 0 at first, (t, 3)."""
    period, phase = rng.uniform(1.3, 2.9, (2, 3)), rng.uniform(0.0, 2.0 * np.pi, (2, 3))
    waves = np.sin(2.0 * np.pi * time[:, np.newaxis, np.newaxis] / period + phase).sum(axis=1)
    return DRIFT / np.sqrt(6.0) * (waves - waves[0])


def reach(name, mechanism, rng):
    """Return times and EE poses of a reach from in front of the handle to the grasp."""
    time = np.arange(round(rng.uniform(*DURATION) * RATE) + 1) / RATE
    rolled = Rotation.from_rotvec([ROLL[name], 0.0, 0.0])

    def near(position, size, mask):
        shift = rolled.apply(scatter(rng, size, mask))
        return position + shift, rolled * Rotation.from_rotvec(scatter(rng, TURN_ERROR, ALL))

    end, end_turn = near(np.zeros(3), HAND_ERROR, NOT_FINGERS)
    start, start_turn = near(np.array(START[name]), START_ERROR, ALL)
    progress = minimum_jerk(time)[:, np.newaxis]
    turn = Rotation.from_rotvec(progress * (end_turn * start_turn.inv()).as_rotvec()) * start_turn
    position = start + progress * (end - start) + drift(rng, time)
    return time, compose(mechanism.handle, make_pose(position, turn))


def pull(name, mechanism, hand, rng):
    """Return times and EE poses of a pull; springs connect a mass with its plan and the handle."""
    time, dt = np.arange(round(rng.uniform(*DURATION) * RATE) + 1) / RATE, 1.0 / RATE / SUBSTEPS
    fine = np.linspace(0.0, time[-1], (len(time) - 1) * SUBSTEPS + 1)
    misjudged, progress = scatter(rng, HAND_ERROR, ALL), minimum_jerk(fine)
    opening, slip = OPENING[name] * (1.0 + 0.02 * rng.normal()), SLIP + 0.02 * rng.normal()
    desired = mechanism.carry(hand[:3], opening * progress, misjudged) + drift(rng, fine)
    desired[:, 2] += RISE[name] * progress
    stiffness = np.array([[GRIP_STIFFNESS], [ARM_STIFFNESS]])
    damping, before = 2.0 * np.sqrt(stiffness * MASS), np.zeros((2, 3))
    position, velocity, opened, opening_rate = hand[:3], np.zeros(3), 0.0, 0.0
    path, openings = [position], [opened]
    for target in desired[1:]:
        point = mechanism.carry(hand[:3], opened)
        stretch = np.stack([point, target]) - position
        grip, arm = stiffness * stretch + damping * (stretch - before) / dt
        before, grip = stretch, grip * PLANE  # the fingers slide up and down on the handle
        velocity = velocity + dt / MASS * (grip + arm)
        position = position + dt * velocity
        opened, opening_rate = mechanism.step(opened, opening_rate, -grip, point, dt)
        path.append(position)
        openings.append(opened)
    angle = 0.0 if mechanism.slides else (1.0 - slip) * np.array(openings)[::SUBSTEPS, np.newaxis]
    turn = Rotation.from_rotvec(angle * np.tile(mechanism.axis, (len(time), 1))) * rotation(hand)
    return time, make_pose(np.array(path)[::SUBSTEPS], turn)


def demonstrate(name, count, seed):
    """Return `count` pairs of demonstrations: the grasp and the opening of `door` or `drawer`."""
    mechanism, pairs = Mechanism(name), []
    for number in range(count):
        rng = np.random.default_rng((seed, number))
        room = planar_pose(*(rng.uniform(-1.0, 1.0, 3) * [2.0, 2.0, np.pi]))
        grasp = reach(name, mechanism, rng)
        motions = grasp, pull(name, mechanism, grasp[1][-1], rng)
        behind = np.array([-ARM_LENGTH, 0.0, 0.0]) + scatter(rng, STAND_ERROR, PLANE)
        stand = (mechanism.handle[:3] + rotation(mechanism.handle).apply(behind))[:2]
        pairs.append([])
        for (time, hand), arriving in zip(motions, (1.0, 0.0), strict=True):
            progress = minimum_jerk(time)[:, np.newaxis] - arriving
            position = stand + BASE_FRACTION * progress * (hand[-1, :2] - hand[0, :2])
            ahead = hand[:, :2] - position
            base = planar_pose(position[:, 0], position[:, 1], np.arctan2(ahead[:, 1], ahead[:, 0]))
            poses = hand, base, np.broadcast_to(mechanism.handle, hand.shape)
            pairs[-1].append(Demonstration(time, *(compose(room, pose).round(6) for pose in poses)))
    return pairs


def main():
    """Write a folder of CSV files for each motion."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("mechanism", choices=sorted(START))
    parser.add_argument("--out", type=Path, required=True, help="folder for grasp/ and open/")
    parser.add_argument("--count", type=int, default=12)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    for number, pair in enumerate(demonstrate(options.mechanism, options.count, options.seed)):
        for motion, demonstration in zip(("grasp", "open"), pair, strict=True):
            folder = options.out / motion
            folder.mkdir(parents=True, exist_ok=True)
            write_demonstration(demonstration, folder / f"{number:02d}.csv")
    print(f"{options.count} demonstrations of each motion in {options.out}")


if __name__ == "__main__":
    main()
