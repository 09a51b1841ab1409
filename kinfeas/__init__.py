"""Learned base motions that keep any end-effector motion kinematically feasible.

`kinfeas.train`, `evaluate`, `export` and `load_policy` import their packages at the first use.
"""

__version__ = "0.2.0"

__all__ = ["Run", "__version__", "evaluate", "export", "load_policy", "train"]


def __getattr__(name: str) -> object:
    """Return what `kinfeas.api` has of this name; it is imported when first asked for."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module("kinfeas.api"), name)


def __dir__() -> list[str]:
    """Return the names of this module, also of what it has not imported yet."""
    return sorted({*globals(), *__all__})
