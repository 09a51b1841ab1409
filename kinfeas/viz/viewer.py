"""Robots and scenes in viser, for pages of recordings and for live ones."""

from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from io import StringIO
from typing import Any

import numpy as np
from matplotlib.colors import to_rgb

from kinfeas.core.spatial import Array
from kinfeas.robots.robot import Robot
from kinfeas.robots.urdf import Shape
from kinfeas.scenes.scene import Scene
from kinfeas.viz.drawing import link_poses, robot_parts, scene_solids
from kinfeas.viz.style import ARM, BODY

FLOOR = (245, 246, 248)
"""Colour of the floor."""

_STILL = 1e-4  # m, and of a quaternion


@contextmanager
def serving(title: str, host: str = "127.0.0.1", port: int = 0) -> Iterator[Any]:
    """Yield a viser server, by default at a free port."""
    import viser

    with redirect_stdout(StringIO()):  # viser prints a banner, `verbose` or not
        server = viser.ViserServer(host, port, title, verbose=False)
    try:
        yield server
    finally:
        with redirect_stdout(StringIO()):
            server.stop()


def draw_scene(server: Any, scene: Scene) -> list[Any]:
    """Draw a scene; return a handle for each of `scene_solids`."""
    return [
        draw(server, f"/{name}/{number}", solid.shape, solid.colour)
        for number, (name, solid) in enumerate(scene_solids(scene))
    ]


def draw(server: Any, name: str, shape: Shape, colour: str | tuple[float, ...]) -> Any:
    """Draw a shape; return its handle."""
    how = {"position": shape.pose[:3], "wxyz": np.roll(shape.pose[3:], 1), "color": rgb(colour)}
    if shape.kind == "box":
        return server.scene.add_box(name, dimensions=shape.size, **how)
    if shape.kind == "cylinder":
        radius, height = shape.size
        return server.scene.add_cylinder(name, radius=radius, height=height, **how)
    return server.scene.add_icosphere(name, radius=shape.size[0], **how)


def place(drawn: Any, pose: Array) -> None:
    """Move a drawn object to a pose (7,), if that is a visible change."""
    wxyz = np.roll(pose[3:], 1)
    if max(np.abs(drawn.position - pose[:3]).max(), np.abs(drawn.wxyz - wxyz).max()) > _STILL:
        drawn.position, drawn.wxyz = pose[:3], wxyz  # each change is a message in the page


def rgb(colour: str | tuple[float, ...]) -> tuple[int, ...]:
    """Return a colour of matplotlib in the range of viser, 0 to 255."""
    shares = to_rgb(colour) if isinstance(colour, str) else colour
    return tuple(round(255.0 * share) for share in shares)


class DrawnRobot:
    """A robot that moves in a page, from its primitive shapes."""

    def __init__(
        self, server: Any, name: str, robot: Robot, colours: tuple[str, str] = (BODY, ARM)
    ) -> None:
        """Draw the robot below the node `name`; colours: body, arm."""
        self._robot = robot
        self._root = server.scene.add_frame(name, show_axes=False)
        self._frames: dict[str, Any] = {}
        for number, (link, shape, arm) in enumerate(robot_parts(robot)):
            if link not in self._frames:
                path = f"{name}/{len(self._frames)}"
                self._frames[link] = server.scene.add_frame(path, show_axes=False)
            draw(server, f"{self._frames[link].name}/{number}", shape, colours[arm])

    def move(self, base_pose: Array, joint_positions: Array) -> None:
        """Show the robot at a base pose (7,) and arm joints (j,)."""
        poses = link_poses(self._robot, base_pose, joint_positions)
        for link, frame in self._frames.items():
            place(frame, poses[link])

    def remove(self) -> None:
        """Remove the robot from the page."""
        self._root.remove()
