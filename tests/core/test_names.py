import pytest

from kinfeas.core.names import check_name


@pytest.mark.parametrize("name", ["pr2", "my robot", "greifer-ü", "a.b"])
def test_names_that_can_be(name):
    check_name(name)


@pytest.mark.parametrize("name", ["", " ", "a/b", "/", "a\nb", "a\x00", "\x1b[31m", "a\u2028b"])
def test_names_that_cannot_be(name):
    with pytest.raises(ValueError, match=r"^'name' must be printable, not empty and without '/'"):
        check_name(name)
