import json

import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.io import strict_json


def nested(depth):
    return '{"a": ' * depth + "1" + "}" * depth


def test_a_mapping_is_read(tmp_path):
    data = {"a": [1, 2.5, {"b": None}], "c": "\u00fc", "d": float("inf")}
    (tmp_path / "a.json").write_text(json.dumps(data))
    assert strict_json.read(tmp_path / "a.json") == data


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "broken JSON: Expecting value"),
        ("{", "broken JSON: Expecting property name"),
        ("{}x", "broken JSON: Extra data"),
        ('{"a": ' + "9" * 5000 + "}", "broken JSON: "),
        ("3", "must hold a mapping of keys to values"),
        ("[]", "must hold a mapping of keys to values"),
        ("[" * 200_000, "broken JSON: nested too deeply"),
        (nested(strict_json.DEEPEST + 1), "broken JSON: nested too deeply"),
        ("[" + nested(strict_json.DEEPEST) + "]", "broken JSON: nested too deeply"),
        ("\udcff", "not a text file in UTF-8"),
    ],
)
def test_anything_else_is_one_sentence(tmp_path, content, message):
    path = tmp_path / "a.json"
    path.write_bytes(content.encode(errors="surrogateescape"))
    with pytest.raises(KinfeasError, match=f"^{path}: {message}") as caught:
        strict_json.read(path)
    assert "\n" not in str(caught.value)


def test_as_deep_as_allowed(tmp_path):
    (tmp_path / "a.json").write_text(nested(strict_json.DEEPEST))
    assert strict_json.read(tmp_path / "a.json")["a"]


def test_a_file_that_is_not_there_or_too_large_is_one_sentence(tmp_path):
    with pytest.raises(KinfeasError, match="none: cannot be read: No such file"):
        strict_json.read(tmp_path / "none")
    (tmp_path / "large").write_bytes(b" " * (strict_json.MAX_BYTES + 1))
    with pytest.raises(KinfeasError, match="large: too large"):
        strict_json.read(tmp_path / "large")
