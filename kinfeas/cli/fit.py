"""`kinfeas fit`: learn an EE motion from recorded demonstrations."""

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from kinfeas.cli import inputs, options
from kinfeas.cli.output import (
    check_file_path,
    check_outputs,
    check_suffix,
    print_table,
    status,
    write_json,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from kinfeas.plugins.fit import Fit


def fit(
    demonstrations: Annotated[
        Path, typer.Option("--demonstrations", help="Folder of *.csv or *.npz files.")
    ],
    out: Annotated[
        Path,
        typer.Option(
            "--out", help="Model file to write, such as model.yaml.", callback=check_file_path
        ),
    ],
    kind: Annotated[
        Literal["imitation", "gaussian_mixture"],
        typer.Option("--kind", help="Motion generator that is to follow the model."),
    ] = "imitation",
    components: Annotated[
        int, typer.Option("--components", min=1, max=50, help="Size of the Gaussian mixture.")
    ] = 8,
    seed: options.Seed = 0,
    json: options.JsonPath = None,
) -> None:
    """Learn an EE motion from recorded demonstrations, for any pose of the handled object.

    A demonstration is a CSV table with the columns time, ee_x, ee_y, ee_z, ee_qx, ee_qy, ee_qz,
    ee_qw and the same of base_ and object_, or an NPZ of the arrays time, ee_pose, base_pose and
    object_pose: world poses in metres and unit quaternions. The motion is learned in the frame
    that the object has at the start.

    Use the model in a task or a test as the parameter [bold]model: path/of/model.yaml[/] of the
    motion generator that [bold]--kind[/] names.
    """
    from kinfeas.io.demonstrations import demonstration_files, read_demonstration
    from kinfeas.plugins.fit import fit as run
    from kinfeas.plugins.fit import write_model

    sources = {"--demonstrations": inputs.of_demonstrations(demonstrations)}
    check_outputs({"--out": out, "--json": json}, sources)
    # By this ending a generator knows the path of a model from a name.
    check_suffix("--out", out, ".yaml", ".yml")
    # The folder's name only: where it lies on this machine says nothing to others.
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
    summary = _summary(found)
    if json is not None:
        write_json(summary, json)
    bare = [file for file, one in zip(files, shown, strict=True) if not one.has_base]
    _show(found, out, _about_base(found, bare))


def _about_base(found: "Fit", bare: "Sequence[Path]") -> str:
    """Return what became of the base, given the files that do not show it."""
    if found.model.has_base:
        return "learned"
    if len(bare) == found.model.fitted_from.demonstrations:
        return "not shown"
    others = f" and {len(bare) - 1} more" if len(bare) > 1 else ""
    return f"not learned, for it is not shown in {bare[0].name}{others}"


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
    }


def _show(found: "Fit", out: Path, base: str) -> None:
    from numpy import rad2deg

    millimetres = [1000.0 * metres for metres in found.position_residual]
    degrees = [float(rad2deg(radians)) for radians in found.rotation_residual]
    count = len(millimetres)
    rows = [
        ["demonstrations", str(count)],
        ["duration, mean", f"{found.duration:.2f} s"],
        ["way of the hand, mean", f"{found.length:.3f} m"],
        ["components", str(len(found.model.components))],
        ["base", base],
        ["distance from the learned path, mean", f"{sum(millimetres) / count:.1f} mm"],
        ["the same of the worst demonstration", f"{max(millimetres):.1f} mm"],
        ["angle from the learned path, mean", f"{sum(degrees) / count:.1f} degrees"],
        ["the same of the worst demonstration", f"{max(degrees):.1f} degrees"],
    ]
    print_table(f"{found.model.kind} model in {out}", ["", " value"], rows)
