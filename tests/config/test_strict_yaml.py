import contextlib
import math

import pytest
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


@pytest.mark.parametrize(("text", "value"), [
    ("1e-3", 1e-3), ("1000_000", "1000_000"), (".inf", math.inf), ("off", "off"), ("010", "010"),
    ("2024-01-01", "2024-01-01"), ("", None), ("{a: [1, b]}", {"a": [1, "b"]}),
])  # fmt: skip
def test_scalars_are_those_of_yaml_1_2(text, value):
    parsed = strict_yaml.parse(text, "x")
    assert parsed == value
    assert type(parsed) is type(value)


@pytest.mark.parametrize(("text", "named"), [
    ("a: 1\nb: [", "line 2"), ("a: 1\nb: 2\na: 3", "line 3: duplicate key 'a'"),
    ("a: 1\nb: &x [1]\nc: *x", "line 2"), ("!!python/object/apply:os.getcwd []", "os.getcwd"),
    ("a: 1\n---\nb: 2", "line 2"), ("[" * 5000, "broken YAML"),
])  # fmt: skip
def test_broken_text_is_an_error_of_one_line(text, named):
    with pytest.raises(KinfeasError, match=r"^file.yaml: broken YAML") as caught:
        strict_yaml.parse(text, "file.yaml")
    assert named in str(caught.value)
    assert "\n" not in str(caught.value)


@given(st.text(alphabet="ab:,-[]{}!&*#|>'\"%@` \n\t~01.e", max_size=40))
def test_no_text_raises_another_error(text):
    with contextlib.suppress(KinfeasError):
        strict_yaml.parse(text, "x")


@given(st.dictionaries(st.text(max_size=8), PLAIN, max_size=4), st.booleans())
def test_write_and_read_are_inverse(tmp_path_factory, data, compact):
    path = tmp_path_factory.mktemp("yaml") / "x.yaml"
    strict_yaml.write(data, path, compact=compact)
    assert strict_yaml.read(path) == data


@pytest.mark.parametrize("data", [
    {"subgoals": [{"motion": {"generator": "os:system"}}]}, {"task.motion.generator": "a.b:c.d"},
    {"space": {"motion": {"choices": [{"generator": "os:system"}]}}},
    {"space": {"task.motion.generator": {"choices": ["linear", "os:system"]}}},
])  # fmt: skip
def test_no_file_names_code(tmp_path, data):
    path = tmp_path / "x.yaml"
    path.write_text(strict_yaml.to_text(data))
    with pytest.raises(KinfeasError, match="generator"):
        strict_yaml.read(path)
    with pytest.raises(KinfeasError, match="generator"):
        strict_yaml.write(data, path)


@pytest.mark.parametrize(
    "content", [b"- 1\n", b"word", b"a: \xff\xfe", b"#" * (strict_yaml.MAX_BYTES + 1), None]
)
def test_unreadable_file_is_named(tmp_path, content):
    path = tmp_path / "x.yaml"
    path.write_text("# nothing yet\n")
    assert strict_yaml.read(path) == {}
    path.unlink()
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(KinfeasError) as caught:
        strict_yaml.read(path)
    assert str(caught.value).startswith(str(path))
