"""Compute golden figures anew: `python -m tests.golden.renew PATTERN ...`, such as 'ik-*'."""

import sys

from tests.golden.compare import ROOT, compute

DATA = ROOT / "tests" / "golden" / "data"

if __name__ == "__main__":
    compute(ROOT, DATA, sys.argv[1:])
