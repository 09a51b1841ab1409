import os
import time

import pytest

from kinfeas.benchmark.timing import best_of, one_core, peak_memory_mb


def test_the_quickest_run_counts():
    naps = iter([0.05, 0.01, 0.03])
    seconds = best_of(3, lambda: time.sleep(next(naps)), at_least=0.0)
    assert 0.01 <= seconds < 0.03


def test_quick_work_is_run_for_a_while():
    runs = []
    best_of(2, lambda: runs.append(time.sleep(0.001)), at_least=0.02)
    assert 3 <= len(runs) <= 20


@pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="needs Linux")
def test_one_core_is_given_back():
    before = os.sched_getaffinity(0)
    with pytest.raises(ZeroDivisionError), one_core():
        assert len(os.sched_getaffinity(0)) == 1
        raise ZeroDivisionError
    assert os.sched_getaffinity(0) == before


def test_peak_memory_grows_with_what_is_held():
    before = peak_memory_mb()
    held = b"x" * int((before + 100.0) * 1e6)  # more than ever before
    assert before + 100.0 <= peak_memory_mb() < 100_000
    del held
