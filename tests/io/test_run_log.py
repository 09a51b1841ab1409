import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kinfeas.config import PluginSpec
from kinfeas.core.errors import KinfeasError
from kinfeas.io.run_log import About, Moment, Recorder, read_record

JOINTS = ("shoulder", "elbow, the left")
ABOUT = About(
    "pr2", "door", "pretrained", "analytic", 0.02, JOINTS, "2026-01-02T03:04:05+00:00", seed=3,
    adapters=(PluginSpec("latency", {"seconds": 0.1}),), filters=(PluginSpec("feasibility"),),
    generators=(PluginSpec("linear", {"gain": 1.0}),), guards={"max_age": 0.2, "max_tilt": None},
)  # fmt: skip


def pose(rng):
    return np.concatenate([rng.normal(size=3), Rotation.random(rng=rng).as_quat()])


def moment(seed, **changes):
    rng = np.random.default_rng(seed)
    values = {
        "time": 0.02 * seed, "age": 0.01, "base_pose": pose(rng),
        "joint_positions": rng.normal(size=2), "desired": pose(rng),
        "goal": pose(rng), "base_twist": rng.normal(size=6),
        "joint_targets": rng.normal(size=2), "feasible": bool(seed % 2), "subgoal": seed // 2,
    }  # fmt: skip
    return Moment(**{**values, **changes})


def write(path, moments, about=ABOUT):
    with Recorder(path, about) as recorder:
        for one in moments:
            recorder.write(one)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "run.csv"


def test_round_trip(path):
    moments = [moment(0, event="start"), moment(1, age=np.nan), moment(2, event='a, "b"\nc')]
    write(path, moments)
    record = read_record(path)
    assert record.about == ABOUT
    assert record.event == ("start", "", 'a, "b" c')
    assert record.subgoal.tolist() == [0, 0, 1]
    assert record.feasible.tolist() == [False, True, False]
    assert np.isnan(record.age).tolist() == [False, True, False]
    for name in ("base_pose", "joint_positions", "desired", "goal", "base_twist", "joint_targets"):
        expected = np.stack([getattr(one, name) for one in moments])
        np.testing.assert_allclose(getattr(record, name), expected, rtol=1e-8)


def test_an_empty_run_leaves_no_file(path):
    with pytest.raises(KinfeasError, match="no robot"), Recorder(path, ABOUT):
        raise KinfeasError("no robot")
    assert not path.exists()


def test_each_line_is_in_the_file_at_once(path):
    with Recorder(path, ABOUT) as recorder:
        for count in (1, 2):
            recorder.write(moment(count))
            assert len(read_record(path).time) == count


def test_a_truncated_file_is_readable(path, caplog):
    write(path, [moment(0), moment(1)])
    whole = path.read_bytes()
    second = whole.rindex(b"\n", 0, -1) + 1
    for end in range(second, len(whole), 7):
        path.write_bytes(whole[:end])
        assert len(read_record(path).time) == 1
    assert "last line" in caplog.text
    caplog.clear()
    path.write_bytes(whole)
    assert len(read_record(path).time) == 2
    assert not caplog.records


BROKEN = {
    "another version": ("# kinfeas record 1", "# kinfeas record 9", "not a run log"),
    "missing": ('"robot": "pr2", ', "", "line 1.*'robot'"),
    "JSON": ('"task": "door",', '"task": "door"', "line 1.*JSON"),
    "joints": ('["shoulder", "elbow, the left"]', "[]", "line 1.*'joints'"),
    "columns": ('elbow, the left"]', 'wrist"]', "line 2"),
    "more": ("\n0.0200,", "\n0.0200,1,", "line 4"),
    "no number": ("\n0.0200,", "\nnan,", "line 4: 'time'"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_broken_lines_are_named(path, name):
    old, new, place = BROKEN[name]
    write(path, [moment(0), moment(1)])
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(KinfeasError, match=f"^{path}.*{place}"):
        read_record(path)


def test_the_last_measurement_alone_may_be_invalid(path):
    invalid = moment(1, base_pose=np.full(7, np.nan))
    write(path, [moment(0), invalid])
    assert np.isnan(read_record(path).base_pose[-1]).all()
    longer = path.with_name("longer.csv")
    write(longer, [moment(0), invalid, moment(2)])
    with pytest.raises(KinfeasError, match=r"line 4: 'base\.x' is not finite"):
        read_record(longer)


def test_empty_runs(path):
    write(path, [moment(0)])
    path.write_text("".join(path.read_text().splitlines(keepends=True)[:2]))
    with pytest.raises(KinfeasError, match="before its first step"):
        read_record(path)
