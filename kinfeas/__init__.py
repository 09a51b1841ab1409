"""Learned base motions that keep any end-effector motion kinematically feasible.

These functions are imported with their packages at the first use.
"""

__version__ = "0.3.0"

_MODULES = {
    "KinfeasError": "core.errors", "ceiling": "api.evaluate", "deploy": "api.deploy",
    "evaluate": "api.evaluate", "export": "api.load", "fit": "api.fit",
    "identify": "api.identify", "load_plan": "api.plan", "load_policy": "api.load",
    "load_robot": "api.load", "plan": "api.plan", "reach": "api.reach", "resume": "api.train",
    "servo": "api.deploy", "train": "api.train", "view": "api.view",
}  # fmt: skip
"""Module that has a name."""

__all__ = ["__version__", *_MODULES]


def __getattr__(name: str) -> object:
    """Return a function or the error; its module is imported when first asked for."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(f"kinfeas.{_MODULES[name]}"), name)


def __dir__() -> list[str]:
    """Return the names of this module, also of what it has not imported yet."""
    return sorted({*globals(), *__all__})
