from kinfeas.api import Run as Run
from kinfeas.api import evaluate as evaluate
from kinfeas.api import export as export
from kinfeas.api import load_policy as load_policy
from kinfeas.api import train as train

__version__: str
