"""A recorded run as a page that stands alone, by viser: the robot moves as it did."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from kinfeas.core import spatial
from kinfeas.core.spatial import Array
from kinfeas.evaluation.recording import Recording
from kinfeas.robots.robot import Robot
from kinfeas.scenes.scene import Scene
from kinfeas.viz.pages.scene import draw_scene
from kinfeas.viz.pages.viser_server import Paths, draw_paths, rgb, serving
from kinfeas.viz.pictures.solids import bodies, parts

_BODY, _ARM = "#c3c9d2", "#5b93cf"
_RATE, _MOST = 15.0, 1200  # pictures per second of the run, and at most in all
_UP = np.array([0.0, 0.0, 1.0])
_CAMERA = np.array([1.8, -2.6, 2.0])  # m, from the middle of the paths


def replay_html(
    recording: Recording, robot: Robot, times: Array, scene: Scene | None = None
) -> str:
    """Return the page of a run.

    Args:
        recording: What happened, t moments.
        robot: Who moved.
        times: Of the moments, shape (t,), seconds.
        scene: What stands around.

    Raises:
        KinfeasError: If viser is not installed.
    """
    desired, ee = recording.desired[:, :3], recording.ee_pose[:, :3]
    failures = desired[~recording.feasible]
    paths = Paths(recording.base_pose[:, :3], desired, ee, recording.goals[:, :3], failures)
    with serving(robot.name) as server:
        middle, size = draw_paths(server, paths)
        server.initial_camera.position = middle + _CAMERA * max(1.0, size / 4.0)
        server.initial_camera.look_at = middle + 0.5 * _UP
        if scene is not None:
            draw_scene(server, scene)
        solids = _draw_robot(server, robot)
        return _film(server, solids, (recording, robot, times))


def _film(server: Any, solids: dict[int, Any], run: tuple[Recording, Robot, Array]) -> str:
    recording, robot, times = run
    tree, _ = parts(robot)
    film = server.get_scene_serializer()
    shown = moments(times)
    for moment, after in zip(shown, [*shown[1:], shown[-1]], strict=True):
        base = recording.base_pose[moment]
        turn = spatial.rotation(base)
        turns, places = bodies(tree, recording.joint_positions[moment])
        for body, solid in solids.items():
            orientation = turn * Rotation.from_matrix(turns[body])
            solid.position = turn.apply(places[body]) + base[:3]
            solid.wxyz = np.roll(orientation.as_quat(), 1)
        film.insert_sleep(max(float(times[after] - times[moment]), 1.0 / _RATE))
    html: str = film.as_html()
    return html


def moments(times: Array) -> NDArray[np.intp]:
    """Return which moments, of which there are t, are shown, ascending and with the last one."""
    seconds = float(times[-1] - times[0])
    count = int(np.clip(np.ceil(seconds * _RATE), 1, min(_MOST, len(times))))
    wanted = np.linspace(times[0], times[-1], count)
    return np.unique(np.append(np.searchsorted(times, wanted), len(times) - 1))


def _draw_robot(server: Any, robot: Robot) -> dict[int, Any]:
    """Draw each rigid part in its own frame; return them by the number of the part."""
    _, faces = parts(robot)
    solids = {}
    for body in sorted({number for number, _ in faces}):
        mine = [face for number, face in faces if number == body]
        corners = np.concatenate([face.corners for face in mine])
        offsets = np.cumsum([0, *(len(face.corners) for face in mine)])
        triangles = [
            (start, start + k, start + k + 1)
            for face, start in zip(mine, offsets[:-1].tolist(), strict=True)
            for k in range(1, len(face.corners) - 1)
        ]
        colour = _ARM if any(face.arm for face in mine) else _BODY
        solids[body] = server.scene.add_mesh_simple(
            f"/robot/{body}", corners, np.array(triangles), color=rgb(colour), flat_shading=True
        )
    return solids
