"""EE motions learned from recorded demonstrations."""

import shlex
from pathlib import Path
from typing import Literal

from kinfeas.api import Name
from kinfeas.core.extras import require
from kinfeas.io.demonstrations import demonstration_files, read_demonstration
from kinfeas.plugins.fit import Fit, write_model
from kinfeas.plugins.fit import fit as learn


def fit(
    demonstrations: Name,
    out: Name,
    *,
    kind: Literal["imitation", "gaussian_mixture"] = "imitation",
    components: int = 8,
    seed: int = 0,
) -> Fit:
    """Learn an EE motion from demonstrations, write its model, and return it.

    Example: `kinfeas.fit("demonstrations/door/open", "my_door.yaml").length`

    Arguments are the options of the command.

    Raises:
        KinfeasError: If there are no demonstrations, or one is invalid.
    """
    require("sklearn")
    # The model is for other machines, too: only the name of the folder.
    folder = shlex.quote(Path(demonstrations).resolve().name)
    command = (
        f"kinfeas fit --demonstrations {folder} --kind {kind} "
        f"--components {components} --seed {seed}"
    )
    files = demonstration_files(Path(demonstrations))
    motions = [read_demonstration(file) for file in files]
    fitted = learn(motions, kind, components, seed, command, [str(file) for file in files])
    write_model(fitted.model, Path(out))
    return fitted
