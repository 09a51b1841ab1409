"""Jobs that are quick, and jobs whose worker dies."""

import os
from pathlib import Path

import numpy as np

from kinfeas.core.errors import KinfeasError
from kinfeas.jobs.job import Job


def draw(description):
    seed, _ = description
    return {"seed": seed, "numbers": np.random.default_rng(seed).normal(size=3).tolist()}


def die_once(description):
    """End this process without a word, the first time."""
    _, folder = description
    if not (folder / "died").exists():
        (folder / "died").touch()
        os._exit(9)
    return draw(description)


def die(description):
    os._exit(9)


def fail(description):
    raise KinfeasError("key 'speed' is wrong")


def jobs(folder: Path, *calls):
    return [
        Job(call, (seed, folder), folder / "results" / f"{seed}.json")
        for seed, call in enumerate(calls)
    ]
