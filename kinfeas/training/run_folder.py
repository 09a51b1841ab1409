"""The folder of a training run: whether one can begin there, or go on; known without torch."""

import shlex
from pathlib import Path
from tempfile import TemporaryFile

from kinfeas.core.errors import KinfeasError
from kinfeas.io.files import writing

SETTINGS = "config.yaml"
"""File with the settings of a run, the first that it writes."""


def check_new(out: Path) -> None:
    """Check that a run can begin in a folder.

    Raises:
        KinfeasError: If there is something in it, it cannot be written, or TensorBoard cannot take
            its name.
    """
    _check_name(out)
    with writing(out):
        # What is hidden may be left of a run that was killed while it wrote its first file.
        if out.is_dir() and any(not one.name.startswith(".") for one in out.iterdir()):
            raise KinfeasError(_taken(out))
        nearest = next(place for place in (out, *out.parents) if place.exists())
        TemporaryFile(dir=nearest).close()


def check_begun(out: Path) -> None:
    """Check that a run has begun in a folder.

    Raises:
        KinfeasError: If it has not, or TensorBoard cannot take the name of the folder.
    """
    _check_name(out)
    if not (out / SETTINGS).is_file():
        raise KinfeasError(f"{out}: not a training run: there is no {SETTINGS} in it")


def _check_name(out: Path) -> None:
    try:
        str(out).encode()
    except UnicodeEncodeError as error:
        raise KinfeasError(
            f"{str(out)!a}: TensorBoard takes only names that are text in this locale; use "
            "another name, a UTF-8 locale, or PYTHONUTF8=1"
        ) from error


def _taken(out: Path) -> str:
    if not (out / SETTINGS).is_file():
        return f"{out}: holds other files, --out needs a new or an empty folder"
    again = f"--resume {shlex.quote(str(out))}"
    return f"{out}: already there; use {again}, or another --out"
