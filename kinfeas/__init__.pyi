from kinfeas.api.deploy import deploy
from kinfeas.api.evaluate import ceiling, evaluate
from kinfeas.api.fit import fit
from kinfeas.api.identify import identify
from kinfeas.api.load import export, load_policy, load_robot
from kinfeas.api.plan import load_plan, plan
from kinfeas.api.reach import reach
from kinfeas.api.servo import servo
from kinfeas.api.train import resume, train
from kinfeas.api.view import view

__all__ = [
    "__version__",
    "ceiling",
    "deploy",
    "evaluate",
    "export",
    "fit",
    "identify",
    "load_plan",
    "load_policy",
    "load_robot",
    "plan",
    "reach",
    "resume",
    "servo",
    "train",
    "view",
]

__version__: str
