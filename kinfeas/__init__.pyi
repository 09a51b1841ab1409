from kinfeas.api import Run, evaluate, export, load_policy, train

__all__ = ["Run", "__version__", "evaluate", "export", "load_policy", "train"]

__version__: str
