import numpy as np

from kinfeas.backends.analytic import AnalyticBackend
from kinfeas.control.surroundings import Surroundings
from kinfeas.core.backend import SCAN_BEAMS, SCAN_RANGE
from kinfeas.kinematics.ik import IkSolver


def test_without_a_scanner_nothing_is_in_range_with_one_warning(hsr, caplog):
    backend = AnalyticBackend(hsr)
    backend.scanner = None
    surroundings = Surroundings(backend, IkSolver(hsr).collision)
    for n in (1, 3):
        np.testing.assert_array_equal(
            surroundings.ranges(n), np.full((n, 2, SCAN_BEAMS), SCAN_RANGE)
        )
    (warning,) = caplog.messages
    assert backend.name in warning
