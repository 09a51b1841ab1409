"""Robots and scenes in viser, for pages of recordings and for live ones."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from kinfeas.core.spatial import Array
from kinfeas.robots.robot import Robot
from kinfeas.robots.urdf import Shape
from kinfeas.scenes.scene import Scene
from kinfeas.viz.shapes import link_poses, robot_parts, scene_solids
from kinfeas.viz.style import ARM, BODY

_FLOOR, _LINES = (245, 246, 248), (205, 210, 217)  # colours
_VIEW = np.array([0.82, -1.18, 0.85])  # from what is shown to the camera, as shares of its radius
_STILL = 1e-4  # m, and of a quaternion


def draw_floor(
    server: Any, size: Sequence[float], cell: float, position: Sequence[float] = (0.0, 0.0, 0.0)
) -> Any:
    """Draw a floor of a size (2,) with a grid; return its handle."""
    return server.scene.add_grid(
        "/floor", size[0], size[1], cell_size=cell, cell_color=_LINES, section_color=_LINES,
        plane_color=_FLOOR, plane_opacity=1, position=position,
    )  # fmt: skip


def draw_scene(server: Any, scene: Scene) -> list[Any]:
    """Draw a scene; return a handle for each of `scene_solids`."""
    return [
        draw(server, f"/{name}/{number}", solid.shape, solid.colour)
        for number, (name, solid) in enumerate(scene_solids(scene))
    ]


def aim(server: Any, points: Array) -> None:
    """Put the camera of a page where it shows all points, shape (k, 3), in metres."""
    low, high = points.min(axis=0), points.max(axis=0)
    middle, radius = (low + high) / 2.0, max(0.5, float(np.linalg.norm(high - low)) / 2.0)
    server.initial_camera.position = middle + radius * _VIEW
    server.initial_camera.look_at = middle


def draw(server: Any, name: str, shape: Shape, colour: str) -> Any:
    """Draw a shape; return its handle."""
    red, green, blue, *alpha = rgb(colour)
    how: dict[str, Any] = {"position": shape.pose[:3], "wxyz": np.roll(shape.pose[3:], 1)}
    how |= {"color": (red, green, blue), "opacity": alpha[0] / 255.0 if alpha else None}
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


def rgb(colour: str) -> tuple[int, ...]:
    """Return a colour, `#rrggbb` or `#rrggbbaa`, in the range of viser, 0 to 255."""
    return tuple(bytes.fromhex(colour.removeprefix("#")))


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
