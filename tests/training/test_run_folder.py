import os

import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.training.run_folder import check_begun, check_new


@pytest.mark.parametrize("name", ["new", "new/below", "empty", "half"])
def test_a_run_begins_where_nothing_is(tmp_path, name):
    (tmp_path / "empty").mkdir()
    (tmp_path / "half" / ".half").mkdir(parents=True)
    before = sorted(tmp_path.rglob("*"))
    check_new(tmp_path / name)
    assert sorted(tmp_path.rglob("*")) == before


def test_a_run_is_gone_on_with_not_overwritten(tmp_path):
    run = tmp_path / "my run"
    run.mkdir()
    (run / "config.yaml").touch()
    check_begun(run)
    with pytest.raises(KinfeasError, match=f"already there; use --resume '{run}', or another"):
        check_new(run)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("others", "others: holds other files, --out needs a new or an empty folder"),
        ("file", "file: cannot be written: Not a directory"),
        ("file/run", "file/run: cannot be written: Not a directory"),
        ("n" * 300, "cannot be written: File name too long"),
    ],
)
def test_where_no_run_can_begin(tmp_path, name, message):
    (tmp_path / "file").touch()
    (tmp_path / "others").mkdir()
    (tmp_path / "others" / "notes.txt").touch()
    with pytest.raises(KinfeasError, match=message):
        check_new(tmp_path / name)


@pytest.mark.skipif(os.geteuid() == 0, reason="nothing is forbidden to root")
def test_a_folder_that_one_may_not_write_into(tmp_path):
    tmp_path.chmod(0o500)
    try:
        with pytest.raises(KinfeasError, match="run: cannot be written: Permission denied"):
            check_new(tmp_path / "run")
    finally:
        tmp_path.chmod(0o700)


@pytest.mark.parametrize("name", ["nothing", "."])
def test_a_folder_that_is_no_run(tmp_path, name):
    with pytest.raises(KinfeasError, match=r"not a training run: there is no config\.yaml in it"):
        check_begun(tmp_path / name)


@pytest.mark.parametrize("check", [check_new, check_begun])
def test_a_name_that_is_no_text_is_refused(tmp_path, check):
    """As `r\xc3\xbcn` is read in the locale C."""
    with pytest.raises(KinfeasError, match="PYTHONUTF8"):
        check(tmp_path / os.fsdecode(b"r\xc3\xbcn").encode().decode("ascii", "surrogateescape"))
