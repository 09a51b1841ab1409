import types

import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.core.plugin_errors import BLAMED, PluginErrors


class OwnError(Exception):
    """What a plugin's author may think up."""


def raising(error, package="outside"):
    """Return a function of a package that raises."""
    module = types.ModuleType(f"{package}.part")
    code = compile("def work(error):\n    raise error\n", f"/somewhere/{package}.py", "exec")
    exec(code, module.__dict__)
    return lambda: module.work(error)


@pytest.mark.parametrize(
    "error", [OwnError("oh"), KeyError("oh"), StopIteration("oh"), SystemExit(7)]
)
def test_any_exception_becomes_one_sentence_with_its_line(error):
    with pytest.raises(KinfeasError) as caught, PluginErrors("it fails:", "outside"):
        raising(error)()
    assert str(caught.value).startswith(f"it fails: {type(error).__name__}: ")
    assert str(caught.value).endswith("(outside.py, line 2)")
    assert caught.value.__cause__ is error


@pytest.mark.parametrize("error", [KeyboardInterrupt(), MemoryError(), KinfeasError("known")])
def test_what_is_nobodys_mistake_passes(error):
    with pytest.raises(type(error)) as caught, PluginErrors("it fails:", "outside"):
        raise error
    assert caught.value is error


def test_our_own_mistakes_keep_their_traceback_and_missing_libraries_do_not():
    with pytest.raises(ZeroDivisionError), PluginErrors("it fails:", "kinfeas"):
        raise ZeroDivisionError
    with (
        pytest.raises(KinfeasError, match="ModuleNotFoundError"),
        PluginErrors("it fails:", "kinfeas"),
    ):
        raise ModuleNotFoundError("no such library")


def test_without_an_error_nothing_happens_again_and_again():
    plugin_errors = PluginErrors("it fails:")
    for _ in range(2):
        with plugin_errors:
            pass
    with pytest.raises(KinfeasError, match=r"^it fails: ValueError: no$"), plugin_errors:
        raise ValueError("no")


@pytest.mark.parametrize("error", [MemoryError(), SystemError(), KinfeasError("known")])
def test_what_is_caught_as_anybodys_is_blamed_on_nobody(error):
    assert isinstance(error, BLAMED)
    assert PluginErrors("it fails:").blame(error) is None


def test_nobody_at_the_keyboard_is_kept_from_ending_the_program():
    assert not issubclass(KeyboardInterrupt, BLAMED)
