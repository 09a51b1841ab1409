import pytest

from kinfeas.benchmark.text import groups, title, to_markdown
from tests.benchmark.benchmark_cases import cells


@pytest.fixture(scope="module")
def text():
    return to_markdown(cells(), "A note.", ["kinfeas benchmark"], ["table.png", "examples-pr2.png"])


def test_a_table_for_each_robot_and_variant(text):
    heads = [line for line in text.splitlines() if line.startswith("## ")]
    assert heads[:3] == ["## PR2", "## HSR", "## PR2, goals up to 1.4 m"]
    assert groups(cells())[-1] == ("pr2", "goals up to 1.4 m")
    assert title("my_robot", "") == "my_robot"


def test_cells_are_as_the_paper_writes_them(text):
    assert "| **92.0 ± 2.0** (92.0) |" in text
    assert "60.0 (60.0) |" in text
    assert "*90.2 (91.2)* |" in text
    assert "98.0 (93.0 - 100.0) |" in text


def test_what_only_the_paper_has_stands_there_too(text):
    rows = [line for line in text.splitlines() if line.startswith("| *paper: ")]
    assert any("geometric_modulation" in row and "64.6" in row for row in rows)
    assert any("demonstrated_base" in row and "30.2" in row for row in rows)


def test_tables_are_tables(text):
    blocks = [block.splitlines() for block in text.split("\n\n") if block.startswith("|")]
    assert len(blocks) == 4
    for block in blocks:
        assert len({line.count("|") for line in block}) == 1
        assert len({len(line) for line in block}) == 1


def test_note_pictures_and_commands(text):
    assert "**A note.**" in text
    assert "![Episodes without a failure](table.png)" in text
    assert "](examples-pr2.png)" in text
    assert "```sh\nkinfeas benchmark\n```" in text
    assert "****" not in to_markdown(cells(), "", [])
