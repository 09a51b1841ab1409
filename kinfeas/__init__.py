"""Learned base motions that keep any end-effector motion kinematically feasible.

The functions below are imported with their packages at the first use.
"""

__version__ = "0.3.0"

_MODULES = {
    "ceiling": "evaluate", "deploy": "deploy", "evaluate": "evaluate", "export": "load",
    "fit": "fit", "identify": "identify", "load_plan": "plan", "load_policy": "load",
    "load_robot": "load", "plan": "plan", "reach": "reach", "resume": "train", "servo": "deploy",
    "train": "train", "view": "view",
}  # fmt: skip
"""Module of `kinfeas.api` that has a function."""

__all__ = ["__version__", *_MODULES]


def __getattr__(name: str) -> object:
    """Return a function of `kinfeas.api`; its module is imported when first asked for."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(f"kinfeas.api.{_MODULES[name]}"), name)


def __dir__() -> list[str]:
    """Return the names of this module, also of what it has not imported yet."""
    return sorted({*globals(), *__all__})
