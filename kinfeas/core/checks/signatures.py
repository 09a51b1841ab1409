"""What the methods of a motion generator take, and whether those of a class do."""

import inspect
from collections.abc import Mapping

from kinfeas.core.errors import KinfeasError

PARAMETERS = {
    "start": ("ee_pose", "target_pose", "rngs"),
    "goal_pose": ("state", "target_pose"),
    "twist": ("state", "ee_pose", "target_pose", "dt"),
    "base_pose": ("state", "target_pose"),
}
"""Of a motion generator, by method."""

SINGLE_PARAMETERS = PARAMETERS | {"start": ("ee_pose", "target_pose", "rng")}
"""Of a class for one motion."""


class SignatureError(KinfeasError, TypeError):
    """A method does not take what its contract says; the sentence names the method and both."""


def require_parameters(
    thing: object, parameters: Mapping[str, tuple[str, ...]], subject: str
) -> None:
    """Raise if a method of `thing` cannot be called with its parameters; absent ones are let be.

    Args:
        thing: Whose methods are looked at.
        parameters: What each of them takes, by position.
        subject: What to call it in errors.

    Raises:
        SignatureError: Names the method, what it must take and what it takes.
    """
    for method, names in parameters.items():
        function = getattr(thing, method, None)
        if not callable(function):
            continue
        try:
            signature = inspect.signature(function)
        except ValueError:  # built in
            continue
        try:
            signature.bind(*names)
        except TypeError as error:
            takes = ", ".join(signature.parameters)
            raise SignatureError(
                f"{subject} must have the method {method}({', '.join(names)}), "
                f"not {method}({takes})"
            ) from error
