"""EE motions learned from recorded demonstrations."""

import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from kinfeas.api import Name
from kinfeas.core.extras import require
from kinfeas.io.demonstrations import demonstration_files, read_demonstration
from kinfeas.plugins.fit import fit as learn
from kinfeas.plugins.fit import write_model


@dataclass(frozen=True)
class FittedMotion:
    """A motion learned from demonstrations.

    Attributes:
        kind: Motion generator of the model.
        demonstrations: Number of demonstrations.
        components: Number of Gaussians.
        base: Whether the base is demonstrated, too.
        duration_s: Duration of the motion, seconds.
        length_m: Length of the EE path, metres.
        position_residual_m: Deviation of each demonstration from the motion, metres.
        rotation_residual_rad: The same in radians.
        sides: The group of each demonstration, 0 or 1: two if they follow two paths.
        without_base: Names of the files without poses of the base.
        files: The demonstrations.
    """

    kind: str
    demonstrations: int
    components: int
    base: bool
    duration_s: float
    length_m: float
    position_residual_m: tuple[float, ...]
    rotation_residual_rad: tuple[float, ...]
    sides: tuple[int, ...]
    without_base: tuple[str, ...]
    files: tuple[Path, ...]


def fit(
    demonstrations: Name,
    out: Name,
    *,
    kind: Literal["imitation", "gaussian_mixture"] = "imitation",
    components: int = 8,
    seed: int = 0,
) -> FittedMotion:
    """Learn an EE motion from demonstrations, write its model, and return its figures.

    Example: `kinfeas.fit("demonstrations/door/open", "my_door.yaml").length_m`

    Args:
        demonstrations: Folder of CSV files.
        out: YAML file of the model, for the motion generator `kind`.
        kind: Motion generator.
        components: Number of Gaussians.
        seed: Seed of all randomness.

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
    model = fitted.model
    write_model(model, Path(out))
    bare = [file.name for file, one in zip(files, motions, strict=True) if not one.has_base]
    return FittedMotion(
        model.kind, model.fitted_from.demonstrations, len(model.components), model.has_base,
        fitted.duration, fitted.length, tuple(fitted.position_residual),
        tuple(fitted.rotation_residual), tuple(fitted.sides), tuple(bare), tuple(files),
    )  # fmt: skip
