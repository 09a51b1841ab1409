"""Why a guard stops a run."""

from kinfeas.core.errors import KinfeasError


class Fault(KinfeasError):  # noqa: N818 - not a mistake of anyone, but what the guards look for
    """Something that a run does not go on with; the sentence names it."""


def beyond(value: float, limit: float) -> str:
    """Return a number above a limit in two decimals, or in as many as show that it is above."""
    rounded = (f"{value:.{decimals}f}" for decimals in range(2, 18))
    return next((text for text in rounded if float(text) > limit), f"{value:g}")


def reason_of(error: BaseException) -> str:
    """Return in one line why something failed, by the words of what it raised, if there are any."""
    return " ".join(str(error).split()) or type(error).__name__
