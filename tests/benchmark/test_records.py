import json

import numpy as np
import pytest

pytest.importorskip("pybullet")

from kinfeas.benchmark.records import from_lists, to_lists
from kinfeas.evaluation.physics.world import PhysicsRecords


def test_what_is_written_is_read_back():
    counts = np.array([0, 2])
    records = PhysicsRecords(
        reached=np.array([True, False]),
        failures=counts,
        max_deviation=np.array([0.01, 0.3]),
        mean_deviation=np.array([0.001, 0.2]),
        final_distance=np.array([0.0, np.inf]),
        joint_jumps=counts,
        steps=np.array([500, 700]),
        done=np.array([True, False]),
        base_collisions=counts,
        arm_collisions=counts,
    )
    lists = json.loads(json.dumps(to_lists(records), allow_nan=False))
    assert lists["final_distance"] == [0.0, None]
    found = from_lists(lists)
    for name, values in vars(records).items():
        np.testing.assert_array_equal(getattr(found, name), values)
        assert getattr(found, name).dtype == values.dtype
