import pytest

from kinfeas.cli.docstrings import read_docstring, unit, unwrapped


class Documented:
    """Moves.

    In a way that
    takes two lines.

    Args:
        speed: Upper limit
            in m/s.
        height (float): In metres: up.

    Raises:
        ValueError: If not.
    """

    def __init__(self, speed, height, backend=None):
        """Make one.

        Args:
            backend: What moves.
            speed: Not this.
        """


def listing():
    """List.

    First line
    second line:

    - one
      and more
    - two
    1. three

    Last.
    """


def test_help_has_one_line_for_each_paragraph_and_item():
    lines = ["List.", "", "First line second line:", "", "- one and more", "- two", "1. three", "",
             "Last."]  # fmt: skip
    assert unwrapped(listing) == "\n".join(lines)
    assert unwrapped(object()).startswith("The base class")
    assert not unwrapped(lambda: None)


def test_summary_text_and_entries_of_class_and_constructor():
    said = read_docstring(Documented)
    assert said.summary == "Moves."
    assert said.text == "Moves.\n\nIn a way that\ntakes two lines."
    assert said.entries == {
        "speed": "Upper limit in m/s.",
        "height": "In metres: up.",
        "backend": "What moves.",
    }


def test_of_nothing_nothing_is_said():
    def bare():
        pass

    said = read_docstring(bare)
    assert (said.summary, said.text, said.entries) == ("", "", {})


@pytest.mark.parametrize(
    ("text", "symbol"),
    [
        ("Upper limit of the speed in m/s.", "m/s"),
        ("Goal distance, metres; the other in radians.", "m"),
        ("Time constant in seconds.", "s"),
        ("Length, m.", "m"),
        ("Rate, 1/s; angular speed", "1/s"),
        ("In rad/s^2 or less", "rad/s^2"),
        ("Change of the acceleration, m/s^3; none", "m/s^3"),
        ("The same, rad/s^3.", "rad/s^3"),
        ("Seconds for which it stands", "s"),
        ("Metres that one radian is worth", "m"),
        ("the key of the robot's heights", ""),
        ("Names, s of them", "s"),
        ("seconds-hand", "s"),
        ("", ""),
    ],
)
def test_unit(text, symbol):
    assert unit(text) == symbol
