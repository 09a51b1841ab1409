import json

import pytest

from kinfeas.cli import options, output
from kinfeas.core.errors import KinfeasError


def test_output_files_are_checked_in_advance(tmp_path):
    check = options.output_file(".png")
    assert check(None) is None
    assert check(tmp_path / "a.PNG") == tmp_path / "a.PNG"
    (tmp_path / "file").touch()
    (tmp_path / "folder.png").mkdir()
    (tmp_path / "lost.png").symlink_to("missing/target")
    for wrong in ("missing/a.png", "file/a.png", "folder.png", "lost.png", "a.txt"):
        with pytest.raises(KinfeasError, match=str(tmp_path / wrong)):
            check(tmp_path / wrong)
    assert len(list(tmp_path.iterdir())) == 3


@pytest.mark.parametrize("path", ["-", "/dev/stdout"])
def test_json_on_standard_output_is_alone_there(kinfeas, tmp_path, path):
    done = kinfeas("plugins", "check", "linear", "--duration", "60", "--json", path, code=0)
    assert json.loads(done.out)["passed"] is True
    assert "motion generator linear" in done.err
    assert list(tmp_path.iterdir()) == []
    assert "linear" in kinfeas("plugins", "check", "linear", "--duration", "60").out


def test_tables_show_text_without_markup_and_whole(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "40")
    odd = "a[/b] [bold]c[/] :cat: \x1b[31m\n"
    name = "runs/deploy/20260102-030405-pr2-tidy_up_the_kitchen.csv"
    output.print_table(odd, ["", " value"], [[odd, name]])
    shown = capsys.readouterr().out
    assert "a[/b] [bold]c[/] :cat: ?[31m?" in shown
    rows = [line.split("│") for line in shown.splitlines() if line.startswith("│")]
    assert "".join(row[2].strip() for row in rows) == name
