"""Learned base motions that keep any end-effector motion kinematically feasible.

train, resume           train a policy; continue a training
evaluate, ceiling       metrics of a policy; the fraction of reachable goals
reach                   base poses from which EE poses are reached
plan, load_plan         base and arm along an EE path; a plan from its file
deploy, servo           run a policy or plan on a robot; follow streams of targets
identify, fit           model of a robot's response; EE motion of demonstrations
export                  policy as an ONNX file
load_policy, load_robot policies and robots
view                    facts on and pictures of scenes and records
KinfeasError            raised for bad input

Each name is imported at its first use, with its packages; `help(kinfeas.train)` shows arguments.
"""

__version__ = "0.3.0"

_MODULES = {
    "KinfeasError": "core.errors", "ceiling": "api.evaluate", "deploy": "api.deploy",
    "evaluate": "api.evaluate", "export": "api.load", "fit": "api.fit",
    "identify": "api.identify", "load_plan": "api.plan", "load_policy": "api.load",
    "load_robot": "api.load", "plan": "api.plan", "reach": "api.reach", "resume": "api.train",
    "servo": "api.servo", "train": "api.train", "view": "api.view",
}  # fmt: skip
"""Module below `kinfeas` that defines each public name."""

__all__ = ["__version__", *_MODULES]


def __getattr__(name: str) -> object:
    """Return a public function or KinfeasError; its module is imported at the first access."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(f"kinfeas.{_MODULES[name]}"), name)


def __dir__() -> list[str]:
    """Return the names of this module, including those that are not imported yet."""
    return sorted({*globals(), *__all__})
