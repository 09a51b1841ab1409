"""What happened in episodes with physics, as JSON can hold it."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from kinfeas.core.metrics import EpisodeRecords


def to_lists(records: EpisodeRecords) -> dict[str, list[Any]]:
    """Return records by the names of their fields: null for a distance that is infinite."""
    return {
        name: [None if value == np.inf else value for value in values.tolist()]
        for name, values in vars(records).items()
        if values is not None
    }


def from_lists(lists: Mapping[str, list[Any]]) -> EpisodeRecords:
    """Return what `to_lists` was given."""
    columns = {
        name: np.array([np.inf if value is None else value for value in values])
        for name, values in lists.items()
    }
    return EpisodeRecords(**columns)
