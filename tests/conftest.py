"""Fixtures and settings that all tests share."""

import os

# Before anything imports them: one thread a library, and no display.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("MPLBACKEND", "Agg")

from hypothesis import settings

# Numba compiles within the first example, and a busy machine takes long over any.
settings.register_profile("kinfeas", deadline=None, derandomize=True)
settings.load_profile("kinfeas")
