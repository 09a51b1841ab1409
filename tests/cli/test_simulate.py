import pytest

from tests.cli.conftest import check_one_line


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (("--backend", "analytic"), "'analytic'"),
        (("--task", "door", "--scene", "room"), "--scene"),
        (("--topics", "pr3"), "'pr3'"),
        (("--scene", "attic"), "attic"),
        (("--scene", "origin.yaml"), "'desk'"),
    ],
)
def test_bad_input_is_one_line(kinfeas, tmp_path, arguments, named):
    pytest.importorskip("pybullet")
    tables = "objects: {desk: {urdf: table.urdf}}"
    (tmp_path / "origin.yaml").write_text(f"name: office\nsize: [4, 4]\n{tables}\n")
    check_one_line(kinfeas("simulate", "--robot", "hsr", *arguments), named)
