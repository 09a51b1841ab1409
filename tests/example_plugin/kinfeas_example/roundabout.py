"""The task `roundabout`: two places, both reached on a spiral."""

from pathlib import Path

from kinfeas.tasks.chain import ChainTask
from kinfeas.tasks.loading import read_chain


def roundabout(**changes: object) -> ChainTask:
    """Go to a shelf and to a tray, each on a spiral."""
    return read_chain(Path(__file__).with_name("roundabout.yaml"), changes)
