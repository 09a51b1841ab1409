"""`kinfeas fit`: an EE motion from recorded demonstrations."""

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from kinfeas.cli import options
from kinfeas.cli.output import print_facts, status, write_json
from kinfeas.core.extras import require

if TYPE_CHECKING:
    from kinfeas.plugins.fit import Fit


def fit(
    demonstrations: Annotated[Path, typer.Option(help="Folder of *.csv files.")],
    out: Annotated[Path, options.file_option("Model to write.", ".yaml", ".yml")],
    kind: Annotated[
        Literal["imitation", "gaussian_mixture"],
        typer.Option(help="Motion generator of the model."),
    ] = "imitation",
    components: Annotated[int, typer.Option(min=1, max=50, help="Number of Gaussians.")] = 8,
    seed: options.Seed = 0,
    json: options.JsonPath = None,
) -> None:
    """Learn an EE motion from demonstrations.

    A demonstration is a CSV table with the columns time, ee_x, ee_y, ee_z, ee_qx, ee_qy, ee_qz,
    ee_qw and the same of base_ and object_: world poses in metres and unit quaternions. The motion
    is learned in the frame of the object at the start.

    Use the model in a task or a test as the parameter model: path/of/model.yaml of the motion
    generator --kind.

    Example: kinfeas fit --demonstrations demonstrations/door/open --out my_door.yaml
    """
    from kinfeas.io.demonstrations import demonstration_files, read_demonstration
    from kinfeas.plugins.fit import fit as run
    from kinfeas.plugins.fit import write_model

    require("sklearn")
    # The model is for other machines, too: only the name of the folder.
    folder = shlex.quote(demonstrations.resolve().name)
    command = (
        f"kinfeas fit --demonstrations {folder} --kind {kind} "
        f"--components {components} --seed {seed}"
    )
    with status("learning"):
        files = demonstration_files(demonstrations)
        shown = [read_demonstration(file) for file in files]
        found = run(shown, kind, components, seed, command, [str(file) for file in files])
    write_model(found.model, out)
    bare = [file.name for file, one in zip(files, shown, strict=True) if not one.has_base]
    summary = {**_summary(found), "without_base": bare}
    write_json(summary, json)
    print_facts(f"{kind} model in {out}", summary)
    if any(found.sides):
        left, right = (
            ", ".join(file.name for file, side in zip(files, found.sides, strict=True) if side == i)
            for i in (0, 1)
        )
        typer.echo(
            "warning: the demonstrations follow two paths, and the model is a path between them; "
            f"fit each group on its own: {left}; {right}",
            err=True,
        )


def _summary(found: "Fit") -> dict[str, object]:
    return {
        "kind": found.model.kind,
        "demonstrations": found.model.fitted_from.demonstrations,
        "components": len(found.model.components),
        "base": found.model.has_base,
        "duration_s": found.duration,
        "length_m": found.length,
        "position_residual_m": list(found.position_residual),
        "rotation_residual_rad": list(found.rotation_residual),
        "sides": list(found.sides),
    }
