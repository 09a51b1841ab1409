import runpy

import pytest

from kinfeas.core import registry
from kinfeas.core.errors import KinfeasError
from kinfeas.core.registry import GROUPS
from kinfeas.templates import Kind
from kinfeas.templates.distribution import write_distribution


@pytest.mark.parametrize("kind", Kind)
def test_each_kind_passes_its_own_test(kind, tmp_path, offer):
    name = f"tried_{kind}"
    written = write_distribution(kind, name, tmp_path / "new")
    assert {path.suffix for path in written} >= {".toml", ".py", ".md"}
    assert all("$" not in path.read_text() for path in written)
    offer(tmp_path / "new")
    assert name in registry.names(kind.group)
    tests = runpy.run_path(str(tmp_path / "new" / f"test_{name}.py"))
    assert [thing() for name, thing in tests.items() if name.startswith("test_")]


def test_there_is_a_template_for_every_group():
    assert {kind.group for kind in Kind} == set(GROUPS)


@pytest.mark.parametrize(
    "name", ["My", "my-motion", "1st", "a__b", "_a", "a_", "class", "none", "linear"]
)
def test_names_that_are_invalid_or_taken_raise(name, tmp_path):
    with pytest.raises(KinfeasError, match=name):
        write_distribution("motion_generator", name, tmp_path / "new")
    assert not (tmp_path / "new").exists()
