"""Fair stopwatch: the best of several repeats, on one core."""

import os
import resource
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager


def best_of(repeats: int, work: Callable[[], object], at_least: float = 0.3) -> float:
    """Return the seconds that the quickest of several runs of `work` took.

    Whatever else runs on the machine only ever adds time.

    Args:
        repeats: Runs at least.
        work: What to run.
        at_least: Seconds for which quick work is run again and again.
    """
    seconds: list[float] = []
    while len(seconds) < repeats or sum(seconds) < at_least:
        seconds.append(_seconds(work))
    return min(seconds)


@contextmanager
def one_core() -> Iterator[None]:
    """Keep this process and its libraries' threads on a single core, where the system can."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(cores)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, cores)


def peak_memory_mb() -> float:
    """Return the most memory that this process or a child has held so far, 10^6 bytes."""
    most = max(
        resource.getrusage(who).ru_maxrss
        for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    )
    # Linux counts kibibytes, macOS bytes.
    return most / 1e6 if sys.platform == "darwin" else most * 1024 / 1e6


def _seconds(work: Callable[[], object]) -> float:
    begun = time.perf_counter()
    work()
    return time.perf_counter() - begun
