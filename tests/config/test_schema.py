from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import pytest

from kinfeas.config import Interval, from_mapping
from kinfeas.config.schema import Place, convert, no_such
from kinfeas.core.errors import KinfeasError

Share = Annotated[float, Interval(0.0, 1.0)]
Count = Annotated[int, Interval(low=1)]


@dataclass(frozen=True)
class Noise:
    base: Share = 0.1
    lag: int = 0


@dataclass(frozen=True)
class Range:
    low: float
    high: float

    def __post_init__(self):
        if self.low > self.high:
            raise ValueError(f"low must not exceed high, not {self.low} and {self.high}")


@dataclass(frozen=True)
class Everything:
    text: str = ""
    flag: bool = False
    count: Count = 1
    number: float = 0.0
    rate: Annotated[float, Interval(low=0.0, open_low=True)] = 1.0
    path: Path = Path()
    choice: Literal["sac", "td3", 3] = "sac"
    maybe: int | None = None
    either: float | tuple[float, float] = 0.0
    numbers: tuple[float, ...] = ()
    pair: tuple[int, str] = (1, "a")
    shares: tuple[Share, ...] = ()
    named: dict[str, int] = field(default_factory=dict)
    free: dict[str, object] = field(default_factory=dict)
    anything: object = None
    noise: Noise = Noise()
    optional: Noise | None = None
    many: dict[str, Noise] = field(default_factory=dict)
    derived: int = field(default=7, init=False)


@dataclass(frozen=True)
class Required:
    steps: Count
    range: Range


def build(**data):
    return from_mapping(Everything, data, "file.yaml")


def test_empty_mapping_gives_the_defaults():
    assert build() == Everything()


@pytest.mark.parametrize(
    ("key", "value", "expected"),
    [
        ("text", "x", "x"),
        ("flag", True, True),
        ("count", 5, 5),
        ("number", 2, 2.0),
        ("number", 2.5, 2.5),
        ("path", "a/b.yaml", Path("a/b.yaml")),
        ("choice", "td3", "td3"),
        ("choice", 3, 3),
        ("maybe", 4, 4),
        ("maybe", None, None),
        ("either", 1, 1.0),
        ("either", [1, 2], (1.0, 2.0)),
        ("numbers", [1, 2.5], (1.0, 2.5)),
        ("numbers", [], ()),
        ("pair", [2, "b"], (2, "b")),
        ("named", {"a": 1}, {"a": 1}),
        ("free", {"a": {"b": [1, None]}}, {"a": {"b": [1, None]}}),
        ("anything", [1, "x"], [1, "x"]),
        ("noise", {"base": 1}, Noise(base=1.0)),
        ("optional", {"lag": 2}, Noise(lag=2)),
        ("optional", None, None),
        ("many", {"a": {}, "b": {"lag": 1}}, {"a": Noise(), "b": Noise(lag=1)}),
    ],
)
def test_value_is_converted(key, value, expected):
    converted = getattr(build(**{key: value}), key)
    assert converted == expected
    assert type(converted) is type(expected)


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("text", 1, "'text' must be a string, not 1"),
        ("text", None, "'text' must be a string, not None"),
        ("flag", 1, "'flag' must be true or false, not 1"),
        ("flag", "yes", "'flag' must be true or false, not 'yes'"),
        ("count", True, "'count' must be a whole number >= 1, not True"),
        ("count", 1.0, "'count' must be a whole number >= 1, not 1.0"),
        ("count", 0, "'count' must be a whole number >= 1, not 0"),
        ("number", True, "'number' must be a finite number, not True"),
        ("number", "1", "'number' must be a finite number, not '1'"),
        ("number", float("nan"), "'number' must be a finite number, not nan"),
        ("number", float("inf"), "'number' must be a finite number, not inf"),
        ("number", 10**400, "'number' must be a finite number, not 1000"),
        ("rate", 0, "'rate' must be a number > 0, not 0"),
        ("rate", float("nan"), "'rate' must be a number > 0, not nan"),
        ("path", 3, "'path' must be a path, not 3"),
        ("choice", "dqn", "'choice' must be one of 'sac', 'td3', 3, not 'dqn'"),
        ("choice", True, "'choice' must be one of"),
        ("maybe", "x", "'maybe' must be a whole number or null, not 'x'"),
        ("either", [1], "'either' must be a finite number or a list of 2 entries"),
        ("numbers", 1, "'numbers' must be a list of each a finite number, not 1"),
        ("numbers", "12", "'numbers' must be a list"),
        ("numbers", [1, "b"], "'numbers.1' must be a finite number, not 'b'"),
        ("pair", [1], "'pair' must be a list of 2 entries"),
        ("pair", ["a", 1], "'pair.0' must be a whole number, not 'a'"),
        ("shares", [0.5, 1.5], "'shares.1' must be a number in [0, 1], not 1.5"),
        ("named", {"a": "b"}, "'named.a' must be a whole number, not 'b'"),
        ("named", {1: 1}, "the key 1 must be a string"),
        ("named", [], "'named' must be a mapping of keys to values, not []"),
        ("noise", {"base": 2}, "'noise.base' must be a number in [0, 1], not 2"),
        ("noise", None, "'noise' must be a mapping of keys to values, not None"),
        (
            "noise",
            {"bas": 1},
            "unknown key 'noise.bas' (did you mean 'base'?); known are base, lag",
        ),
        ("optional", {"lag": "x"}, "'optional.lag' must be a whole number, not 'x'"),
        ("many", {"a": {"lag": "x"}}, "'many.a.lag' must be a whole number, not 'x'"),
        ("derived", 3, "unknown key 'derived'"),
        ("txt", "x", "unknown key 'txt' (did you mean 'text'?); known are anything, choice"),
    ],
)
def test_error_names_file_key_value_and_what_is_allowed(key, value, message):
    with pytest.raises(KinfeasError) as caught:
        build(**{key: value})
    assert str(caught.value).startswith(f"file.yaml: {message}")
    assert "\n" not in str(caught.value)


def test_long_value_is_cut_short():
    with pytest.raises(KinfeasError) as caught:
        build(count="x" * 10_000)
    assert len(str(caught.value)) < 120


def test_missing_key():
    with pytest.raises(
        KinfeasError, match=r"^f: 'steps' is missing; it must be a whole number >= 1"
    ):
        from_mapping(Required, {"range": {"low": 0, "high": 1}}, "f")
    with pytest.raises(KinfeasError, match=r"^f: 'range.high' is missing"):
        from_mapping(Required, {"steps": 1, "range": {"low": 0}}, "f")


@dataclass(frozen=True)
class Named:
    many: dict[str, Range]


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["many.cap.low=1"], "there is no 'many.cap' (did you mean 'cup'?); known are cup, mug"),
        (["many.a.low=1", "many.b.high=2"], "there is no 'many.a'; known are cup, mug"),
        (["many.cap={low: 1}"], "'many.cap.high' is missing"),
        (["many.cap={}"], "'many.cap.low' is missing"),
    ],
)
def test_an_override_within_an_entry_that_is_not_there(overrides, message):
    data = {"many": {"cup": {"low": 0, "high": 1}, "mug": {"low": 0, "high": 1}}}
    with pytest.raises(KinfeasError) as caught:
        from_mapping(Named, data, "f", overrides)
    assert str(caught.value).startswith(f"--set {overrides[0]}: {message}")


def test_overrides_may_make_an_entry_bit_by_bit():
    made = from_mapping(Named, {"many": {}}, "f", ["many.cup.low=0", "many.cup.high=1"])
    assert made == Named({"cup": Range(0, 1)})


def test_an_entry_that_lacks_a_key_in_the_file_is_its_own_fault():
    with pytest.raises(KinfeasError, match=r"^f: 'many.cup.high' is missing"):
        from_mapping(Named, {"many": {"cup": {"low": 0}}}, "f", ["many.mug={low: 0, high: 1}"])


def test_check_across_fields_names_the_block():
    with pytest.raises(KinfeasError, match=r"^f: 'range': low must not exceed high, not 2.0 and"):
        from_mapping(Required, {"steps": 1, "range": {"low": 2, "high": 1}}, "f")


def test_check_across_fields_names_the_file_and_all_that_was_set():
    with pytest.raises(KinfeasError, match=r"^f with --set low=3: low must not exceed high, not 3"):
        from_mapping(Range, {"low": 1, "high": 2}, "f", ["low=3"])


@pytest.mark.parametrize("data", [None, [], "x", 3])
def test_data_must_be_a_mapping(data):
    with pytest.raises(KinfeasError, match=r"^f: must be a mapping of keys to values, not"):
        from_mapping(Everything, data, "f")


@dataclass(frozen=True)
class Unsupported:
    value: Any


def test_unsupported_field_is_the_programmers_error():
    with pytest.raises(TypeError, match="not supported"):
        from_mapping(Unsupported, {"value": 1}, "f")


@pytest.mark.parametrize(
    ("interval", "inside", "outside", "text"),
    [
        (Interval(0, 1), (0, 0.5, 1), (-0.1, 1.1), "in [0, 1]"),
        (Interval(0, 1, open_low=True), (0.1, 1), (0,), "in (0, 1]"),
        (Interval(0, 1, open_high=True), (0, 0.9), (1,), "in [0, 1)"),
        (Interval(low=2), (2, 1e300), (1,), ">= 2"),
        (Interval(low=2, open_low=True), (3,), (2,), "> 2"),
        (Interval(high=2), (2, -1e300), (3,), "<= 2"),
        (Interval(high=2, open_high=True), (1,), (2,), "< 2"),
        (Interval(1, 10_000_000), (1e7,), (1e7 + 1,), "in [1, 10000000]"),
        (Interval(-1e6, 2.5e6), (0,), (3e6,), "in [-1000000, 2500000]"),
        (Interval(low=1e-9, high=1e300), (1,), (0,), "in [1e-09, 1e+300]"),
    ],
)
def test_interval(interval, inside, outside, text):
    assert all(value in interval for value in inside)
    assert not any(value in interval for value in (*outside, float("nan"), float("inf")))
    assert str(interval) == text


def test_converts_plain_values_to_types_that_a_file_can_hold():
    place = Place("file.yaml", "speed")
    assert convert(tuple[float, ...], [1, 2], place) == (1.0, 2.0)
    assert convert(Path | None, "a", place) == Path("a")
    for kind, value in [(slice, [1]), ("float", "x"), (str, slice), (list[float], [1])]:
        assert convert(kind, value, place) is value
    with pytest.raises(KinfeasError, match=r"file\.yaml: 'speed' must be a finite number, not 'x'"):
        convert(float, "x", place)


def test_no_such_lists_what_there_is():
    assert no_such("pr3", ["tiago", "pr2"]) == " (did you mean 'pr2'?); known are pr2, tiago"
    assert no_such("x", []) == "; known are none"
