"""Why a guard stops a run."""

from kinfeas.errors import KinfeasError


class Fault(KinfeasError):  # noqa: N818 - not a mistake of anyone, but what the guards look for
    """Something that a run does not go on with; the sentence names it."""
