"""Files of waypoints: both forms mean the same, and a bad one is named in one sentence."""

import numpy as np
import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.plugins.waypoints import read_waypoints

YAML = "poses:\n- [1, 2, 3, 0, 0, 0, 1]\n- [1, 2, 4, 0, 0, 0.7071, 0.7071]\n"
CSV = "x,y,z,qx,qy,qz,qw\n1,2,3,0,0,0,1\n1,2,4,0,0,0.7071,0.7071\n"
TIMED = "note,qw,x,y,z,qx,qy,qz,time\na,1,1,2,3,0,0,0,0.5\nb,0.7071,1,2,4,0,0,0.7071,2\n"


def write(folder, name, text):
    path = folder / name
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    ("name", "text", "time"),
    [
        ("w.yaml", YAML, None),
        ("w.yml", YAML + "time: [0.5, 2]\n", [0.5, 2.0]),
        ("w.csv", CSV, None),
        ("w.csv", TIMED, [0.5, 2.0]),
        ("W.CSV", TIMED, [0.5, 2.0]),
        ("W.YAML", YAML, None),
    ],
)
def test_reads_both_forms(tmp_path, name, text, time):
    poses, read = read_waypoints(write(tmp_path, name, text))
    half = np.sqrt(0.5)
    assert np.allclose(poses, [[1, 2, 3, 0, 0, 0, 1], [1, 2, 4, 0, 0, half, half]], atol=1e-15)
    assert (read is None) == (time is None)
    assert time is None or read.tolist() == time


@pytest.mark.parametrize(
    ("name", "text", "problem"),
    [
        ("w.txt", CSV, "must be a .yaml or .csv file of waypoints"),
        ("w.yaml", "poses:\n- [1, 2, 3, 0, 0, 0, 1]\n", "has 1 waypoints, at least 2"),
        ("w.yaml", "poses: []\n", "has 0 waypoints, at least 2"),
        ("w.yaml", "poses:\n- [1, 2, 3]\n", "'poses.0'"),
        ("w.yaml", YAML + "speed: 2\n", "unknown key 'speed'"),
        ("w.yaml", YAML + "time: [1]\n", "'time' has 1 entries for 2 waypoints"),
        ("w.yaml", YAML + "time: [1, 1]\n", "waypoint 2: must be later than the one before"),
        ("w.yaml", YAML + "time: [0, 1e300]\n", "waypoint 2: must be at most 100000 s later"),
        ("w.yaml", YAML.replace("0.7071]", "0.9]"), "waypoint 2: must have a unit quaternion"),
        ("w.csv", "x,y,z,qx,qy,qz\n", "line 1: column 'qw' is missing"),
        ("w.csv", CSV.replace("4,0", "far,0"), "line 3, z: 'far' is not a number"),
        ("w.csv", CSV.replace("4,0", "inf,0"), "waypoint 2: must be of finite numbers"),
        ("w.csv", CSV.replace("4,0", "4e6,0"), "waypoint 2: must be of finite numbers"),
        ("w.csv", TIMED.replace(",2\n", ",nan\n"), "waypoint 2: must be later"),
    ],
)
def test_names_what_is_wrong(tmp_path, name, text, problem):
    path = write(tmp_path, name, text)
    with pytest.raises(KinfeasError, match=problem) as caught:
        read_waypoints(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["none.yaml", "none.csv"])
def test_names_a_file_that_is_not_there(tmp_path, name):
    with pytest.raises(KinfeasError, match=f"{name}: cannot be read: No such file"):
        read_waypoints(tmp_path / name)
    with pytest.raises(KinfeasError, match="not a text file in UTF-8"):
        path = tmp_path / "w.csv"
        path.write_bytes(b"\xff\xfe\x00")
        read_waypoints(path)
