import numpy as np
import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import IDENTITY
from kinfeas.plugins.waypoints import Waypoints, read_waypoints
from tests.builders import assert_near
from tests.plugins.conftest import DT, WAYPOINTS, apart, run, write_waypoints

TIME = [0.0, 6.0, 16.0, 40.0]
YAML = "poses:\n- [1, 2, 3, 0, 0, 0, 1]\n- [1, 2, 4, 0, 0, 0.7071, 0.7071]\n"
CSV = "x,y,z,qx,qy,qz,qw\n1,2,3,0,0,0,1\n1,2,4,0,0,0.7071,0.7071\n"
TIMED = "note,qw,x,y,z,qx,qy,qz,time\na,1,1,2,3,0,0,0,0.5\nb,0.7071,1,2,4,0,0,0.7071,2\n"


def from_the_first(generator, duration, poses=WAYPOINTS):
    """Return poses and twists of a motion that begins at the first waypoint; target: origin."""
    path, twists, _ = run(generator, poses[:1], IDENTITY[np.newaxis], duration)
    return path[:, 0], twists[:, 0]


def test_passes_every_waypoint_smoothly(files):
    poses, twists = from_the_first(Waypoints(file=files["waypoints"]), 60.0)
    for waypoint in WAYPOINTS:
        assert np.add(*apart(poses, waypoint)).min() < 0.03
    # Where the turn reverses, the motion would jerk by 0.1 rad/s if it only kept to its limits.
    assert np.abs(np.diff(twists, axis=0)).max() < 0.05


def test_meets_the_times_of_the_file_and_rests_at_repeated_waypoints(tmp_path):
    file = write_waypoints(tmp_path / "timed.csv", time=TIME)
    poses, _ = from_the_first(Waypoints(file=file, max_angular_velocity=10.0), 50.0)
    for moment, waypoint in zip(TIME, WAYPOINTS, strict=True):
        assert_near(poses[round(moment / DT)], waypoint, 2e-3, 1e-2)
    rest = WAYPOINTS[[0, 0, 1]]
    file = write_waypoints(tmp_path / "rest.csv", rest, [0.0, 5.0, 20.0])
    assert apart(from_the_first(Waypoints(file=file), 4.0)[0], rest[0])[0].max() < 0.02
    with pytest.raises(KinfeasError, match="waypoint 2"):
        Waypoints(file=write_waypoints(tmp_path / "untimed.csv", rest))


@pytest.mark.parametrize(
    ("name", "text", "time"),
    [("w.yml", YAML + "time: [0.5, 2]\n", [0.5, 2.0]), ("w.csv", CSV, None),
     ("W.CSV", TIMED, [0.5, 2.0])],
)  # fmt: skip
def test_files_are_yaml_or_csv(tmp_path, name, text, time):
    (tmp_path / name).write_text(text)
    poses, read = read_waypoints(tmp_path / name)
    half = np.sqrt(0.5)
    assert np.allclose(poses, [[1, 2, 3, 0, 0, 0, 1], [1, 2, 4, 0, 0, half, half]], atol=1e-15)
    assert (None if read is None else read.tolist()) == time


@pytest.mark.parametrize(("name", "text", "named"), [
    ("w.yaml", "poses:\n- [1, 2, 3, 0, 0, 0, 1]\n", "at least 2"),
    ("w.yaml", YAML + "speed: 2\n", "'speed'"),
    ("w.yaml", YAML + "time: [1, 1]\n", "row 2"),
    ("w.yaml", YAML.replace("0.7071]", "0.9]"), "row 2"),
    ("w.csv", "x,y,z,qx,qy,qz\n", "'qw'"),
    ("w.csv", CSV.replace("4,0", "inf,0"), "row 2"),
    ("w.csv", TIMED.replace(",2\n", ",nan\n"), "row 2"),
])  # fmt: skip
def test_wrong_files_raise(tmp_path, name, text, named):
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(KinfeasError, match=f"{path}.*{named}"):
        read_waypoints(path)
