"""The keyword parameters that a plugin is built with: known by name, in the types it asks for."""

import inspect
import math
from collections.abc import Mapping
from typing import Any

from kinfeas.config import convert
from kinfeas.core.errors import KinfeasError, no_such


class MissingParameterError(KinfeasError):
    """A plugin was not given a parameter that it needs.

    Attributes:
        parameter: Its name.
    """

    def __init__(self, parameter: str, message: str) -> None:
        super().__init__(message)
        self.parameter = parameter


def signature_of(factory: Any) -> inspect.Signature:
    """Return the signature of a class or function, with its annotations as types where it can."""
    try:
        return inspect.signature(factory, eval_str=True)
    # Annotations may be of names that only a type checker imports.
    except (NameError, AttributeError, SyntaxError, TypeError):
        return inspect.signature(factory)


def check_names(signature: inspect.Signature, given: Mapping[str, object]) -> None:
    """Do nothing if parameters are those that a signature asks for.

    Raises:
        KinfeasError: If one is unknown or missing; the sentence names it and what there is.
    """
    by_name = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
    taken = {p.name: p for p in signature.parameters.values() if p.kind in by_name}
    open_ended = any(p.kind is p.VAR_KEYWORD for p in signature.parameters.values())
    for name in given:
        if name not in taken and not open_ended:
            raise KinfeasError(f"unknown parameter {name!r}{no_such(name, taken)}")
    for name, parameter in taken.items():
        if parameter.default is parameter.empty and name not in given:
            raise MissingParameterError(
                name, f"the parameter {name!r} is missing; known are {', '.join(sorted(taken))}"
            )


def in_types(
    signature: inspect.Signature, given: Mapping[str, object], subject: str
) -> dict[str, object]:
    """Return parameters in the types that they are annotated with; a default stays as it is.

    Args:
        signature: Of what is to be given them.
        given: Keyword parameters, as a YAML block gives them, and objects that it knows of.
        subject: Whose they are, as an error begins.

    Raises:
        KinfeasError: If one has another type or range.
    """
    typed = dict(given)
    for name in given.keys() & signature.parameters.keys():
        value, taken = given[name], signature.parameters[name]
        # What `.inf` means, is for the plugin to say.
        endless = isinstance(value, float) and not math.isfinite(value)
        if endless or value is taken.default:
            continue
        converted = convert(taken.annotation, value, subject, name)
        # A number stays as it was written, for errors that quote it.
        typed[name] = value if isinstance(value, int | float) else converted
    return typed
