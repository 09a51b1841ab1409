import json
import os
from pathlib import Path

import pytest

from kinfeas.cli import output
from kinfeas.cli.inputs import of_policy
from kinfeas.core.errors import KinfeasError
from kinfeas.io.demonstrations import write_demonstration
from tests.cli.conftest import is_one_line
from tests.plugins.conftest import door_demonstrations


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
    assert output.share(0.0, 0.0, 0.1) == "0.0 %  (0.0 - 10.0)"
    assert output.share(None, None, None) == output.share(None) == "-"


def test_tables_hold_every_cell(capsys):
    output.print_table("title", ["name", " value"], [["a", "1"], ["b", "22"]])
    printed = capsys.readouterr().out
    for text in ("title", "name", "value", "a", "b", "22"):
        assert text in printed


def test_a_narrow_table_cuts_nothing_off(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "40")
    name = "runs/deploy/20260102-030405-pr2-tidy_up_the_kitchen.csv"
    output.print_table("title", ["", ""], [["record", name]])
    rows = [line.split("│") for line in capsys.readouterr().out.splitlines() if "│" in line]
    assert "".join(row[2].strip() for row in rows) == name


def test_what_was_written_is_said_but_not_into_it(capsys):
    output.say_written(Path("a.png"), None, Path("/dev/stdout"), Path("b.html"))
    assert capsys.readouterr().out == "a.png\nb.html\n"


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


def test_long_work_leaves_lines_in_a_file(capfd, monkeypatch):
    now = 0.0
    monkeypatch.setattr(output.time, "monotonic", lambda: now)
    with output.progress("8 cells", 8.0) as advance:
        for seconds in (10.0, 20.0, 30.0, 239.8):
            now = seconds
            advance(1.0)
    assert capfd.readouterr() == ("", " 25%  8 cells, 1:00 left\n 50%  8 cells, 4:00 left\n")


def test_a_slow_beginning_says_nothing_of_the_rest(capfd, monkeypatch):
    now = 0.0
    monkeypatch.setattr(output.time, "monotonic", lambda: now)
    with output.progress("ceiling") as advance:
        for seconds, amount in ((20.0, 0.0007), (40.0, 0.0), (60.0, 0.1993)):
            now = seconds
            advance(amount)
    lines = "  0%  ceiling\n  0%  ceiling\n 20%  ceiling, 2:41 left\n"
    assert capfd.readouterr() == ("", lines)


def test_times_are_rounded_whole():
    assert [output.minutes(seconds) for seconds in (0.0, 59.7, 119.7, 4503.0)] == [
        "0:00",
        "1:00",
        "2:00",
        "75:03",
    ]


ODD = "a[/b] [bold]c[/] :cat: \x1b[31m\n"


def test_a_table_shows_text_as_it_stands(capsys):
    output.print_table(ODD, ["", f" {ODD}"], [[ODD, "1"]])
    assert capsys.readouterr().out.count("a[/b] [bold]c[/] :cat: ?[31m") == 3


def test_what_is_being_done_is_shown_as_it_stands(capsys):
    with output.progress(ODD) as advance, output.status(ODD) as show:
        advance(1.0)
        show(ODD)


def test_a_place_for_a_file_may_be_a_pipe_a_link_or_the_output(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to("target")
    for path in (tmp_path / "pipe", tmp_path / "link", Path("/dev/stdout"), Path("/dev/fd/1")):
        assert output.check_file_path(path) == path
    (tmp_path / "lost").symlink_to("missing/target")
    for wrong in (tmp_path / "lost", tmp_path / ("a" * 300)):
        with pytest.raises(KinfeasError, match="cannot be written"):
            output.check_file_path(wrong)


def test_two_options_may_name_two_files_or_one_pipe(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    apart = {"--json": tmp_path / "a", "--picture": tmp_path / "b", "--html": None}
    for paths in (apart, dict.fromkeys(("--json", "--picture"), tmp_path / "pipe")):
        output.check_apart(paths)


@pytest.mark.parametrize("same", ["a", "../{}/a", "link"])
def test_two_options_must_not_name_one_file(tmp_path, same):
    (tmp_path / "link").symlink_to("a")
    other = tmp_path / same.format(tmp_path.name)
    with pytest.raises(KinfeasError, match=r"^--json and --picture must differ, but both name .*"):
        output.check_apart({"--json": tmp_path / "a", "--html": None, "--picture": other})


@pytest.mark.parametrize(
    "line",
    [
        "deploy pretrained --backend analytic --goal 1 0 1 --record same --json ./same",
        "deploy same --backend analytic --goal 1 0 1 --json same",
        "export pretrained --out same --json same",
        "export --check same --json same",
        "evaluate --policy pretrained --adapters ideal --picture same --json same",
        "view --picture same --html same",
        "view --record same --json same",
        "plugins check linear --picture same --json same",
        "fit --demonstrations . --out same --json same",
        "benchmark --quick --out same --json same",
        "benchmark --quick --publish same --json same",
    ],
)
def test_every_command_refuses_one_file_for_two(kinfeas, tmp_path, line):
    done = kinfeas(*line.split())
    assert is_one_line(done), done.err
    assert "must differ, but both name" in done.err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("file", "line"),
    [
        ("shown/0.csv", "fit --demonstrations shown --out shown/0.csv"),
        ("shown/0.csv", "fit --demonstrations shown --out model.yaml --json shown/../shown/0.csv"),
        ("run/config.yaml", "export run --out run/config.yaml"),
        ("run/config.yaml", "evaluate --policy run --json run/config.yaml"),
        ("run/config.yaml", "speed --policy run --json run/config.yaml"),
        ("run/config.yaml", "benchmark --runs run --json run/config.yaml"),
        ("run/checkpoints/best/policy.json", "deploy run --json run/checkpoints/best/policy.json"),
        ("run/checkpoints/best/policy.json",
         "export run/checkpoints/best --out x.onnx --json run/checkpoints/best/policy.json"),
        ("mine.yaml", "evaluate --policy pretrained --robot mine.yaml --json mine.yaml"),
        ("mine.yaml", "evaluate --policy pretrained --task mine.yaml --json ./mine.yaml"),
        ("mine.yaml", "evaluate --policy pretrained --adapters mine.yaml --json mine.yaml"),
        ("mine.yaml", "evaluate --policy pretrained --set task.model=mine.yaml --json mine.yaml"),
        ("mine.yaml", "ceiling --robot mine.yaml --json mine.yaml"),
        ("mine.yaml", "ceiling --task mine.yaml --json mine.yaml"),
        ("mine.yaml", "deploy pretrained --robot mine.yaml --json mine.yaml"),
        ("mine.yaml", "deploy pretrained --task mine.yaml --json mine.yaml"),
        ("mine.yaml", "deploy pretrained --adapters mine.yaml --json mine.yaml"),
        ("mine.yaml", "deploy pretrained --guards mine.yaml --json mine.yaml"),
        ("mine.yaml", "export pretrained --robot mine.yaml --out x.onnx --json mine.yaml"),
        ("mine.yaml", "simulate --robot mine.yaml --json mine.yaml"),
        ("mine.yaml", "simulate --scene mine.yaml --json mine.yaml"),
        ("mine.yaml", "simulate --topics mine.yaml --json mine.yaml"),
        ("mine.yaml", "speed --robot mine.yaml --json mine.yaml"),
        ("mine.yaml", "view --scene mine.yaml --json mine.yaml"),
        ("mine.yaml", "benchmark --config mine.yaml --json mine.yaml"),
        ("mine.yaml", "plugins info mine.yaml --json mine.yaml"),
        ("mine.yaml", "plugins check waypoints --set file=mine.yaml --json mine.yaml"),
    ],
)  # fmt: skip
def test_no_command_writes_over_what_it_reads(kinfeas, tmp_path, file, line):
    (tmp_path / "shown").mkdir()
    (tmp_path / "run" / "checkpoints" / "best").mkdir(parents=True)
    (tmp_path / file).write_text("mine")
    done = kinfeas(*line.split())
    assert is_one_line(done), done.err
    assert "must differ, but both name" in done.err or "is not written over" in done.err
    assert (tmp_path / file).read_text() == "mine"


def test_results_may_lie_beside_what_is_read(tmp_path):
    (tmp_path / "run").mkdir()
    places = of_policy(tmp_path / "run")
    output.check_outputs({"--json": tmp_path / "run" / "out.json"}, {"--policy": places})
    with pytest.raises(KinfeasError, match=r"^--json: .*/new belongs to what --policy names"):
        new = tmp_path / "run" / "checkpoints" / "new"
        output.check_outputs({"--json": new}, {"--policy": places})


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("view --picture room.txt", "--picture: room.txt must end in .png"),
        ("view --html room", "--html: room must end in .html"),
        ("plugins check linear --picture a.jpg", "--picture: a.jpg must end in .png"),
        ("export pretrained --out pr2.yaml", "--out: pr2.yaml must end in .onnx"),
        ("deploy pretrained --goal 1 0 1 --record run", "--record: run must end in .csv"),
    ],
)
def test_files_end_in_what_they_are(kinfeas, tmp_path, line, message):
    done = kinfeas(*line.split())
    assert is_one_line(done), done.err
    assert message in done.err
    assert list(tmp_path.iterdir()) == []


def test_a_device_or_a_pipe_may_be_called_anything(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", Path("/dev/stdout"), Path("/dev/fd/1"), Path("/dev/null")):
        output.check_outputs({"--picture": path}, {"--scene": [tmp_path / "room.yaml"]})
        output.check_suffix("--out", path, ".onnx")
    for path in (tmp_path / "pipe", Path("/dev/null")):
        output.check_outputs({"--picture": path}, {"--set": [path, tmp_path / "room.yaml"]})


@pytest.mark.parametrize(
    ("file", "line"),
    [
        ("model.yaml", "fit --demonstrations shown --out model.yaml"),
        ("room.png", "view --picture room.png"),
        ("run.png", "view --record run.csv --picture run.png"),
        ("motions.png", "plugins check linear --duration 5 --picture motions.png"),
    ],
)
def test_a_full_disk_leaves_what_was_there(kinfeas, inputs, monkeypatch, file, line):
    (inputs / file).write_text("old")
    for name in ("write_text", "write_bytes"):
        monkeypatch.setattr(Path, name, full_disk)
    done = kinfeas(*line.split())
    assert is_one_line(done), done.err
    assert f"{file}: cannot be written: No space left on device" in done.err
    assert (inputs / file).read_text() == "old"


@pytest.fixture
def inputs(kinfeas, tmp_path):
    """The folder that commands run in, with what some of them read."""
    (tmp_path / "shown").mkdir()
    write_demonstration(door_demonstrations(1)[0], tmp_path / "shown" / "0.csv")
    about = ("--backend", "analytic", "--goal", "1", "0", "1", "--record", "run.csv")
    kinfeas("deploy", "pretrained", *about, "--no-real-time", "--seconds", "0.1")
    return tmp_path


def full_disk(path, content, **_):
    with path.open("wb") as file:
        file.write(b"the first bytes")
    raise OSError(28, "No space left on device")


@pytest.mark.parametrize("path", ["-", "/dev/stdout", "/dev/fd/1"])
def test_results_may_go_to_the_output_and_nothing_else_does(kinfeas, tmp_path, path):
    done = kinfeas("plugins", "check", "linear", "--duration", "60", "--json", path)
    assert done.code == 0, done.err
    assert json.loads(done.out)["passed"] is True
    assert "the same question gets the same answer" in done.err  # of the table
    assert "motion generator linear passes" in done.err
    assert list(tmp_path.iterdir()) == []


def test_only_the_command_that_is_asked_to_keeps_its_output_free(kinfeas):
    kinfeas("view", "--json", "-")
    assert "scene room" in kinfeas("view").out
