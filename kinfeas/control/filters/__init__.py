"""Command filters; entry points `kinfeas.filters`.

A filter changes the base commands of a policy before they are sent. The loop applies a list of
them in order.
"""

from collections.abc import Sequence

from kinfeas.config import PluginSpec
from kinfeas.core import registry
from kinfeas.core.policy import CommandFilter

GROUP = "kinfeas.filters"


def build_filters(specs: Sequence[PluginSpec]) -> list[CommandFilter]:
    """Return the filters of a list, each built with its parameters."""
    return [registry.build(GROUP, spec.name, spec.parameters) for spec in specs]
