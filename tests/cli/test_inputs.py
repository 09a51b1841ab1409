from pathlib import Path

from kinfeas.cli import inputs


def test_names_are_no_files(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "list").write_text("")
    assert inputs.named(None) == inputs.named("pr2") == []
    for name in ("own.yaml", "own/scout", "list"):
        assert inputs.named(name) == [Path(name)]
    assert inputs.named(Path("guards")) == [Path("guards")]


def test_a_policy_is_a_file_or_the_parts_of_its_run(tmp_path):
    assert inputs.of_policy(None) == []
    for name in ("pr2.onnx", "rollout_planner:pr2.onnx"):
        assert inputs.of_policy(name) == [Path("pr2.onnx")]
    parts = inputs.of_policy(tmp_path)
    assert {tmp_path / "config.yaml", tmp_path / "checkpoints"} <= set(parts)


def test_settings_name_files_by_their_values():
    given = ["task.model=door.yaml", "task.file = './a.csv'", "dt=0.1", "world={}", "broken"]
    assert inputs.of_settings(given) == [Path("door.yaml"), Path("./a.csv")]
    assert inputs.of_settings(None) == []
