"""Checks of the objects and arrays that plugins return."""

import inspect
from collections.abc import Mapping

import numpy as np

from kinfeas.core.backend import RobotState
from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import Array

MOTION_PARAMETERS = {
    "start": ("ee_pose", "target_pose", "rngs"),
    "goal_pose": ("state", "target_pose"),
    "twist": ("state", "ee_pose", "target_pose", "dt"),
    "base_pose": ("state", "target_pose"),
}
"""Parameters of the methods of a motion generator."""

SINGLE_MOTION_PARAMETERS = MOTION_PARAMETERS | {"start": ("ee_pose", "target_pose", "rng")}
"""Parameters of the methods of a class for one motion."""

_UNIT_TOLERANCE = 1e-6


class SignatureError(KinfeasError, TypeError):
    """A method of a plugin has other parameters than its contract."""


def require_parameters(
    thing: object, parameters: Mapping[str, tuple[str, ...]], subject: str
) -> None:
    """Check that the methods of an object accept their parameters; methods may be absent.

    Args:
        thing: The object.
        parameters: Positional parameters by method.
        subject: Name of the object in errors.

    Raises:
        SignatureError: If a method has other parameters.
    """
    for method, names in parameters.items():
        function = getattr(thing, method, None)
        if not callable(function):
            continue
        signature = inspect.signature(function)
        try:
            signature.bind(*names)
        except TypeError as error:
            raise SignatureError(
                f"{subject} must have the method {method}({', '.join(names)}), "
                f"not {method}({', '.join(signature.parameters)})"
            ) from error


def array_fault(value: object, shape: tuple[int, ...], *, finite: bool = True) -> str:
    """Return how a value differs from a numeric array of `shape`, or an empty string."""
    if not isinstance(value, np.ndarray):
        return f"is a {type(value).__name__}, not an array of shape {shape}"
    if value.shape != shape:
        return f"has shape {value.shape}, not {shape}"
    if value.dtype.kind not in "iuf":
        return f"is an array of {value.dtype}"
    return "is not finite" if finite and not np.isfinite(value).all() else ""


def check_array(value: object, shape: tuple[int, ...], what: str, *, finite: bool = True) -> None:
    """Check that a value is a numeric array of `shape`.

    Raises:
        KinfeasError: If it is not; the message begins with `what`.
    """
    if fault := array_fault(value, shape, finite=finite):
        raise KinfeasError(f"{what} {fault}")


def are_unit(poses: Array) -> bool:
    """Return whether the quaternions of poses, shape (..., 7), have unit length."""
    deviation = np.abs(np.linalg.norm(poses[..., 3:], axis=-1) - 1.0).max(initial=0.0)
    return bool(deviation < _UNIT_TOLERANCE)


def check_state(
    state: object, robots: int, joints: int, source: str, *, finite: bool = True
) -> None:
    """Check the state that a backend or adapter returns.

    Args:
        state: The returned value.
        robots: Number of robots.
        joints: Number of arm joints.
        source: Plugin and method, for errors.
        finite: Whether poses and joint positions must be finite.

    Raises:
        KinfeasError: If it is no `RobotState`, or an array has another shape.
    """
    if not isinstance(state, RobotState):
        raise KinfeasError(f"{source} must return a RobotState, not a {type(state).__name__}")
    poses, arms = (robots, 7), (robots, joints)
    check_array(state.base_pose, poses, f"{source}: base_pose", finite=finite)
    check_array(state.joint_positions, arms, f"{source}: joint_positions", finite=finite)
    if state.ee_in_base is not None:
        check_array(state.ee_in_base, poses, f"{source}: ee_in_base", finite=finite)
    shapes = {"base_twist": (robots, 6), "joint_velocities": arms, "age": (robots,)}
    for name, shape in shapes.items():
        if (value := getattr(state, name)) is not None:
            check_array(value, shape, f"{source}: {name}", finite=False)
    if state.true_state is not None:
        check_state(state.true_state, robots, joints, f"{source}: true_state", finite=finite)
