import contextlib
import math
import resource

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from kinfeas.config import strict_yaml
from kinfeas.core.errors import KinfeasError

SCALARS = (
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(max_size=20)
)
PLAIN = st.recursive(
    SCALARS,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner),
    max_leaves=12,
)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e-3", 1e-3),
        ("-1.5E+2", -150.0),
        ("3.", 3.0),
        (".5", 0.5),
        ("7", 7),
        ("1_000", 1000),
        ("-12_000_000", -12_000_000),
        ("1_0", "1_0"),
        ("1__000", "1__000"),
        ("1000_000", "1000_000"),
        ("1_000_", "1_000_"),
        ("1_000.5", "1_000.5"),
        ("!!int 7", 7),
        ("!!float 7", 7.0),
        ("!!float 1e3", 1000.0),
        ("!!str 7", "7"),
        ("!!bool true", True),
        ("!!null ''", None),
        ("!!seq [1]", [1]),
        ("!!map {a: 1}", {"a": 1}),
        ("'&a !!set'", "&a !!set"),
        (".inf", math.inf),
        ("true", True),
        ("off", "off"),
        ("yes", "yes"),
        ("010", "010"),
        ("1:30", "1:30"),
        ("2024-01-01", "2024-01-01"),
        ("null", None),
        ("", None),
        ("[1, [a, b]]", [1, ["a", "b"]]),
        ("{a: {b: 1}}", {"a": {"b": 1}}),
    ],
)
def test_parse_reads_what_one_would_expect(text, value):
    parsed = strict_yaml.parse(text, "x")
    assert parsed == value
    assert type(parsed) is type(value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: 1\nb: [", "in line 2"),
        ("a: 1\nb: 2\na: 3", "in line 3: the key 'a' stands there twice"),
        ("a: {b: 1, b: 2}", "the key 'b' stands there twice"),
        ("a: &x 1\nb: *x", "aliases"),
        ("&x [*x]", "aliases"),
        ("a: 1\nb: &x 2", "in line 2: anchors (&name) and aliases (*name) are not allowed"),
        ("&x {a: 1}", "in line 1: anchors"),
        ("a: *x", "in line 1: anchors (&name) and aliases (*name) are not allowed"),
        ("a: 1\nb: !!binary aGk=", "in line 2: could not determine a constructor for the tag"),
        ("!!set {a, b}", "2002:set'; allowed: !!map, !!seq, !!str, !!null, !!bool, !!int, !!float"),
        ("!!timestamp 2024-01-01", "2002:timestamp'; allowed:"),
        ("!!omap [a: 1]", "2002:omap'; allowed:"),
        ("!!pairs [a: 1]", "2002:pairs'; allowed:"),
        ("{!!merge x: {a: 1}}", "2002:merge'; allowed:"),
        ("!!str {!!value x: a}", "2002:value'; allowed:"),
        ("!own {a: 1}", "'!own'; allowed:"),
        ("a: 1\nb: !!int 1_0", "in line 2: '1_0' is no int"),
        ("!!int 0x10", "'0x10' is no int"),
        ("!!float 1:30.0", "'1:30.0' is no float"),
        ("!!bool yes", "'yes' is no bool"),
        ("!!null x", "'x' is no null"),
        ("!!int [1]", "is no int"),
        ("!!python/object/apply:os.getcwd []", "could not determine a constructor"),
        ("a: 1\n---\nb: 2", "in line 2"),
        ("[" * 5000, "nested too deeply"),
        ("!!int x", "broken YAML"),
        ("!!bool x", "broken YAML"),
        ("!!timestamp x", "broken YAML"),
        ("{[a]: 1}", "broken YAML"),
        ("a: \x00", "broken YAML"),
        ("\t", "in line 1"),
    ],
)
def test_parse_refuses_in_one_line(text, message):
    with pytest.raises(KinfeasError, match=r"^file.yaml: broken YAML") as caught:
        strict_yaml.parse(text, "file.yaml")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@given(st.text(alphabet="ab:,-[]{}!&*#|>'\"%@` \n\t~01.e", max_size=40))
def test_parse_fails_in_no_other_way(text):
    with contextlib.suppress(KinfeasError):
        strict_yaml.parse(text, "x")


@given(st.dictionaries(st.text(max_size=8), PLAIN, max_size=4))
def test_write_and_read_are_inverse(tmp_path_factory, data):
    path = tmp_path_factory.mktemp("yaml") / "x.yaml"
    strict_yaml.write(data, path)
    assert strict_yaml.read(path) == data


def test_read_agrees_with_the_standard_on_ordinary_text(tmp_path):
    text = "a: 1\nb: [1.5, 'x', -2]\nc:\n  d: |\n    long\n    text\n  e: null # why\n"
    (tmp_path / "x.yaml").write_text(text)
    assert strict_yaml.read(tmp_path / "x.yaml") == yaml.safe_load(text)


def test_read_empty_file_as_empty_mapping(tmp_path):
    (tmp_path / "x.yaml").write_text("# nothing yet\n")
    assert strict_yaml.read(tmp_path / "x.yaml") == {}


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"- 1\n", "must hold a mapping"),
        (b"word", "must hold a mapping"),
        (b"a: \xff\xfe", "UTF-8"),
        (b"#" * (strict_yaml.MAX_BYTES + 1), "too large"),
    ],
)
def test_read_refuses(tmp_path, content, message):
    path = tmp_path / "x.yaml"
    path.write_bytes(content)
    with pytest.raises(KinfeasError, match=message) as caught:
        strict_yaml.read(path)
    assert str(caught.value).startswith(str(path))


def test_read_refuses_what_is_no_file(tmp_path):
    with pytest.raises(KinfeasError, match="cannot be read: No such file"):
        strict_yaml.read(tmp_path / "absent.yaml")
    with pytest.raises(KinfeasError, match="cannot be read: Is a directory"):
        strict_yaml.read(tmp_path)


def test_write_refuses_an_absent_folder(tmp_path):
    with pytest.raises(KinfeasError, match="cannot be written: No such file"):
        strict_yaml.write({}, tmp_path / "absent" / "x.yaml")


def test_compact_puts_a_row_on_a_line(tmp_path):
    path, matrix = tmp_path / "matrix.yaml", [[1.0 / 3.0] * 40, [2e-9] * 40]
    strict_yaml.write({"name": "a: b", "matrix": matrix}, path, compact=True)
    assert strict_yaml.read(path) == {"name": "a: b", "matrix": matrix}
    assert path.read_text().count("\n") == 4


def test_a_failed_write_leaves_the_old_file(tmp_path):
    path = tmp_path / "file.yaml"
    path.write_text("old")
    limit = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, limit[1]))
    try:
        with pytest.raises(KinfeasError, match=r"file.yaml: cannot be written: File too large"):
            strict_yaml.write({"numbers": list(range(1000))}, path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limit)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]
