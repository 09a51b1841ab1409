import json
from pathlib import Path

import pytest

from kinfeas.cli import output
from kinfeas.errors import KinfeasError


def test_json_is_written_whole(tmp_path):
    path = tmp_path / "out.json"
    path.write_text("old")
    output.write_json({"a": [1, 2.5, None]}, path)
    assert json.loads(path.read_text()) == {"a": [1, 2.5, None]}
    assert list(tmp_path.iterdir()) == [path]


def test_a_failed_write_leaves_the_old_file(tmp_path):
    path = tmp_path / "out.json"
    path.write_text("old")
    with pytest.raises(ValueError, match="JSON"):
        output.write_json({"a": float("nan")}, path)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("use", [output.check_file_path, lambda path: output.write_json(1, path)])
def test_a_place_that_cannot_be_written(tmp_path, use):
    (tmp_path / "file").write_text("")
    for path in (tmp_path / "missing" / "out.json", tmp_path / "file" / "out.json"):
        with pytest.raises(KinfeasError, match="cannot be written"):
            use(path)


def test_a_folder_is_no_file(tmp_path):
    with pytest.raises(KinfeasError, match="is a folder"):
        output.check_file_path(tmp_path)


def test_checking_leaves_nothing_behind(tmp_path):
    path = tmp_path / "out.json"
    assert output.check_file_path(path) == path
    assert output.check_file_path(None) is None
    assert output.check_file_path(Path("out.json")) == Path("out.json")
    assert list(tmp_path.iterdir()) == []


def test_shares_as_per_cent():
    assert output.share(0.5) == "50.0 %"
    assert output.share(0.984, 0.97, 0.9916) == "98.4 %  (97.0 - 99.2)"


def test_tables_hold_every_cell(capsys):
    output.print_table("title", ["name", " value"], [["a", "1"], ["b", "22"]])
    printed = capsys.readouterr().out
    for text in ("title", "name", "value", "a", "b", "22"):
        assert text in printed


def test_progress_goes_to_standard_error(capsys):
    with output.progress("work", 2) as advance:
        advance(1)
        advance(1)
    with output.status("now") as show:
        show("then")
    assert capsys.readouterr().out == ""


def test_a_bar_leaves_nothing_in_a_file(capfd):
    with output.progress("work", 2.0) as advance:
        advance(1.0)
    assert capfd.readouterr() == ("", "")
