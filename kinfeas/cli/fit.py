"""`kinfeas fit`: an EE motion from recorded demonstrations."""

from pathlib import Path
from typing import Literal

import typer

from kinfeas.cli import options
from kinfeas.cli.options import option
from kinfeas.cli.output import print_facts, status, write_json


def fit(
    demonstrations: Path = option(..., "Folder of *.csv files."),
    out: Path = options.file_option(..., "Model to write.", ".yaml", ".yml"),
    kind: Literal["imitation", "gaussian_mixture"] = option("imitation", "Generator of the model."),
    components: int = option(8, "Number of Gaussians.", min=1, max=50),
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
    from kinfeas.api import fit as api

    with status("learning"):
        motion = api.fit(demonstrations, out, kind=kind, components=components, seed=seed)
    names = [Path(name).name for name in motion.names]
    facts = {
        "kind": kind,
        "demonstrations": len(names),
        "components": len(motion.model.components),
        "base": motion.model.has_base,
        "duration_s": motion.duration,
        "length_m": motion.length,
        "position_residual_m": list(motion.position_residual),
        "rotation_residual_rad": list(motion.rotation_residual),
        "sides": list(motion.sides),
        "without_base": [name for name, has in zip(names, motion.has_base, strict=True) if not has],
    }
    write_json(facts, json)
    print_facts(f"{kind} model in {out}", facts)
    if any(motion.sides):
        sides = list(zip(names, motion.sides, strict=True))
        left, right = (", ".join(name for name, side in sides if side == i) for i in (0, 1))
        typer.echo(
            "warning: the demonstrations follow two paths, and the model is a path between them; "
            f"fit each group on its own: {left}; {right}",
            err=True,
        )
