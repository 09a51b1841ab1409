"""EE motions learned from recorded demonstrations."""

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from annotated_types import Interval

from kinfeas.api import Name
from kinfeas.api.load import checked, text_of
from kinfeas.core.extras import require
from kinfeas.core.quantities import Seed
from kinfeas.io.demonstrations import demonstration_files, read_demonstration
from kinfeas.plugins.fit import MotionFit, write_model
from kinfeas.plugins.fit import fit as learn
from kinfeas.plugins.imitation import Kind

Components = Annotated[int, Interval(ge=1, le=50)]


def fit(
    demonstrations: Name | Sequence[Name],
    out: Name,
    *,
    kind: Kind = "imitation",
    components: int = 8,
    seed: int = 0,
) -> MotionFit:
    """Learn an EE motion from demonstrations, write its model, and return it.

    Example: `kinfeas.fit("demonstrations/door/open", "my_door.yaml").length`

    Arguments are the options of the command.

    Raises:
        KinfeasError: If there are no demonstrations, or one is invalid.
    """
    require("sklearn")
    kind = checked(Kind, kind, "kind")
    components = checked(Components, components, "components")
    seed = checked(Seed, seed, "seed")
    if isinstance(demonstrations, str) or not isinstance(demonstrations, Sequence):
        demonstrations = [demonstrations]
    sources = [Path(text_of(source, "demonstrations")) for source in demonstrations]
    out = Path(text_of(out, "out"))
    # Models are shared between machines: their command has names of files, but no paths.
    names = shlex.join(source.resolve().name for source in sources)
    command = f"kinfeas fit {names} --kind {kind} --components {components} --seed {seed}"
    files = [file for source in sources for file in demonstration_files(source)]
    motions = [read_demonstration(file) for file in files]
    fitted = learn(motions, kind, components, seed, command, [str(file) for file in files])
    write_model(fitted.model, out)
    return fitted
