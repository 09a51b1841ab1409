"""Where a simulated robot stands, and what stands around it."""

import numpy as np

from kinfeas.backends.pybullet.backend import PyBulletBackend
from kinfeas.core.backend import RobotState, build_backend
from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import planar_pose
from kinfeas.core.start import episode_rng
from kinfeas.envs.world import evaluation_world
from kinfeas.kinematics.ik import IkSolver
from kinfeas.robots.robot import Robot
from kinfeas.scenes.scene import Scene, read_scene
from kinfeas.tasks.task import Task


def set_stage(
    robot: Robot,
    task: Task | None = None,
    scene: str | None = None,
    numbers: tuple[int, int] = (1, 0),
    *,
    gui: bool = False,
) -> tuple[PyBulletBackend, RobotState]:
    """Return a world and where the robot stands in it.

    Args:
        robot: Who is played.
        task: As in an episode of which; at the origin and at home by default.
        scene: What stands around without a task; a floor and nothing else by default.
        numbers: Seed and episode of the task.
        gui: Whether to show it in a window.

    Raises:
        KinfeasError: If PyBullet is not installed, the scene is unknown or broken, or something of
            it stands where the robot begins.
    """
    parameters = evaluation_world("pybullet", robot.name).backend_parameters
    around = read_scene(scene) if scene is not None else None
    built = build_backend("pybullet", {**parameters, "gui": gui}, robot=robot, scene=around)
    assert isinstance(built, PyBulletBackend)
    backend = built
    if task is None:
        origin = planar_pose(*np.zeros((3, 1)))
        state = backend.reset(origin, robot.home["home"][np.newaxis])
        if around is not None and not backend.sims[0].free():
            touched = _in_the_way(backend, around)
            backend.close()
            raise KinfeasError(touched)
        return backend, state
    start = backend.stage(task).sample(IkSolver(robot), episode_rng(*numbers))
    return backend, backend.reset(start.base_pose[np.newaxis], start.joint_positions[np.newaxis])


def _in_the_way(backend: PyBulletBackend, scene: Scene) -> str:
    """Return the sentence that names what a robot at the origin touches."""
    simulation = backend.sims[0]
    found = simulation.contacts()
    things = simulation.furniture.bodies if simulation.furniture else {}
    bodies = {number: repr(name) for name, number in things.items()}
    touched = {body for _, body, _ in found.base | found.arm}
    names = sorted(bodies.get(one, "the floor") for one in touched)
    return (
        f"scene {scene.name}: robot {backend.robot.name!r} begins at the origin and would "
        f"touch {', '.join(names)} there"
    )
