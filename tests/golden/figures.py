"""The figures that are pinned: the only module of these tests that uses the package.

Each function of `FIGURES` returns arrays by name. The names are those of the stored files: if the
package renames something, only this module changes.
"""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import onnxruntime

from kinfeas.config.recipes import load_section
from kinfeas.control.filters.obstacle_distance import VelocityDamper
from kinfeas.core.backend import ObstacleDistances
from kinfeas.envs.world import World, WorldConfig
from kinfeas.evaluation.evaluate import configure, run
from kinfeas.kinematics.drive import command_size
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolver
from kinfeas.policies.export import export
from kinfeas.policies.loading import load_policy
from kinfeas.policies.network import read_network
from kinfeas.robots.loading import load_robot
from kinfeas.tasks.loading import load_task
from kinfeas.training.config import TrainConfig
from kinfeas.training.train import train

ROBOTS = ("pr2", "tiago", "hsr")
TASKS = ("ggr", "ggr_restricted", "pick_place", "door", "drawer")
FEASIBILITY_FILTER = ["feasibility"]
PATH_PLANNER = ["path_planner", "feasibility"]
SEED = 1


def episodes(robot, task, count, filters=None, backend="analytic"):
    """Return the records of episodes of the pretrained policy."""
    known = load_robot(robot)
    settings = {} if filters is None else {"world.filters": filters}
    config = configure(known, task, backend, episodes=count, seed=SEED, settings=settings)
    return _records(run(config, load_policy("pretrained", known))[0])


def obstacle_filter(robot, count=300, obstacles=3):
    """Return commands, and what the obstacle filter makes of them among random obstacles."""
    base, rng = load_robot(robot).base, np.random.default_rng(SEED)
    angles = rng.uniform(-np.pi, np.pi, (count, obstacles))
    directions = np.stack([np.cos(angles), np.sin(angles)], axis=2)
    distances = rng.uniform(-0.02, 0.4, (count, obstacles))
    commands = rng.uniform(-1.0, 1.0, (count, 4, command_size(base)))

    class Around:
        def obstacle_distances(self, within):
            found = np.where(distances < within, distances, np.inf)
            return ObstacleDistances(0.3 * directions, directions, found)

    constraints = VelocityDamper(base, 0.1, 0.03).constraints(Around(), count)
    return {"commands": commands, "filtered": constraints.hold(commands)}


def ik(robot, count=1000):
    """Return IK solutions from unrelated joint positions (cold) and from near the target (warm)."""
    known = load_robot(robot)
    solver, rng = IkSolver(known), np.random.default_rng(SEED)
    lower, upper = known.finite_joint_limits
    goal, cold = (rng.uniform(lower, upper, (count, len(lower))) for _ in range(2))
    reachable_in_time = known.max_joint_velocity * 0.1
    warm = np.clip(goal + rng.uniform(-1.0, 1.0, goal.shape) * reachable_in_time, lower, upper)
    # Rounded, so that the targets stay fixed if forward kinematics change in the last bits.
    targets = forward(solver.chain, goal).astype(np.float32)
    found = {
        "cold": solver.solve(targets.astype(np.float64), cold),
        "warm": solver.solve(targets.astype(np.float64), warm, reachable_in_time),
    }
    figure = {"targets": targets}
    for start, solution in found.items():
        for name in ("joint_positions", "feasible", "position_error", "rotation_error"):
            figure[f"{start}_{name}"] = getattr(solution, name)
    return figure


def policy(robot, count=8, steps=5):
    """Return observations at the start and after some steps of each task, and the actions there.

    The actions are those of the network and those of its ONNX export in onnxruntime.
    """
    known = load_robot(robot)
    folder = known.folder / "policies" / "pretrained"
    network, observations = read_network(folder, known), []
    for task in TASKS:
        world = World(known, load_task(task, {}), WorldConfig(), SEED)
        world.loop.set_policy(network)
        observations.append(world.start(range(count)).copy())
        for _ in range(steps):
            world.step(network.act(world.loop.observation))
        observations.append(world.loop.observation.values.copy())
    seen = np.concatenate(observations)
    with TemporaryDirectory() as temporary:
        file = Path(temporary) / "policy.onnx"
        export(folder, known, file)
        exported = _run_onnx(file, seen)
    return {"observations": seen, "network_actions": network(seen), "onnx_actions": exported}


def training(robot, gradient_steps=20):
    """Return the weights of the policy after a few gradient steps."""
    envs, start = 16, 320
    schedule = {"minutes": None, "evaluations": 1, "evaluation_episodes": 1}
    settings = {"robot": robot, "seed": SEED, "num_envs": envs, "action_repeat": 1}
    settings |= {"schedule": {**schedule, "steps": start + envs * gradient_steps}}
    settings |= {"learner.learning_starts": start}
    chosen = load_section(TrainConfig, "train", robot, settings)
    with TemporaryDirectory() as temporary:
        train(chosen, Path(temporary) / "run")
        network = read_network(Path(temporary) / "run" / "checkpoints" / "last", load_robot(robot))
    return {
        "first_layer": network.weights[0],
        "last_layer": network.weights[-1],
        "biases": np.concatenate(network.biases),
    }


def _records(records):
    names = ("success", "reached", "failures", "max_deviation", "mean_deviation", "final_distance")
    names += ("joint_jumps", "steps", "task_done", "base_collisions", "arm_collisions")
    found = {name: getattr(records, name) for name in names}
    return {name: values for name, values in found.items() if values is not None}


def _run_onnx(file, seen):
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    session = onnxruntime.InferenceSession(file, options, providers=["CPUExecutionProvider"])
    name = session.get_inputs()[0].name
    rows = seen.astype(np.float32)[:, np.newaxis]
    return np.concatenate([session.run(None, {name: row})[0] for row in rows])


FIGURES: dict[str, Callable[[], dict[str, np.ndarray]]] = {
    **{f"plain-{r}-{t}": partial(episodes, r, t, 20, []) for r in ROBOTS for t in TASKS},
    **{
        f"feasibility_filter-{r}-{t}": partial(episodes, r, t, 10, FEASIBILITY_FILTER)
        for r in ROBOTS
        for t in TASKS
    },
    **{f"path_planner-{r}": partial(episodes, r, "drawer", 2, PATH_PLANNER) for r in ROBOTS},
    # Plans differ with the last bits of contacts, and so do grasps of a drawer by HSR.
    **{
        f"physics-{r}": partial(episodes, r, "door", 2, filters, "pybullet")
        for r, filters in (("pr2", ["feasibility"]), ("tiago", ["feasibility"]), ("hsr", []))
    },
    **{f"obstacle_filter-{r}": partial(obstacle_filter, r) for r in ROBOTS},
    **{f"ik-{r}": partial(ik, r) for r in ROBOTS},
    **{f"policy-{r}": partial(policy, r) for r in ROBOTS},
    "training-pr2": partial(training, "pr2"),
}
"""Functions that return a figure, by its name; the part before the first dash is its kind."""
