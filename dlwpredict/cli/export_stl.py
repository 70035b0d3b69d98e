"""``dlwpredict export-stl``: the solid under a height map, for the printer's slicer."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dlwpredict.cli import options
from dlwpredict.cli.console import say, warn
from dlwpredict.cli.plotting import Plot, check_plot, draw
from dlwpredict.cli.streams import tell
from dlwpredict.errors import InputError, blaming
from dlwpredict.files import read_height_map
from dlwpredict.files.atomic import replacing
from dlwpredict.files.plausibility import unusual_height
from dlwpredict.files.stl import write_solid
from dlwpredict.metrology.missing import fill_missing
from dlwpredict.solid.mesh import merged, solid_of

COMMAND = "export-stl"
FIGURES = True


def run(
    height_map: Annotated[Path, typer.Argument(help="Height map, z = 0 on the substrate.", show_default=False)],
    output: options.Output,
    fill: options.Fill = None,
    base_um: Annotated[
        float,
        typer.Option("--base-um", help="Thickness of a plate under the whole map.", **options.LENGTH),
    ] = 0.0,
    min_thickness_um: Annotated[
        float,
        typer.Option("--min-thickness-um", help="What stands is at least this high: one slice.", **options.LENGTH),
    ] = 0.1,
    max_faces: Annotated[
        int | None,
        typer.Option(help="Merge triangles if there are more and --max-error-um allows it.", min=1, show_default=False),
    ] = None,
    max_error_um: Annotated[
        float, typer.Option(help="How far merged triangles may be from any height, µm.", **options.LENGTH)
    ] = 0.01,
    pitch_um: options.PitchUm = None,
    z_scale: options.ZScale = None,
    plot: Plot = None,
    overwrite: options.Overwrite = False,
) -> None:
    """Write a watertight binary STL (µm, flat base at z = 0); nothing is written where the height is 0.

    $ dlwpredict export-stl corrected.tif -o part.stl
    """
    options.check_outputs(output, plot, overwrite=overwrite)
    check_plot(plot)
    if output.suffix.lower() != ".stl":
        raise InputError(f"found {output.suffix or 'no ending'}", where=output, key="format", allowed="allowed: .stl")
    part = read_height_map(height_map, pitch_um=options.pitch(pitch_um), z_scale=z_scale)
    for doubt in unusual_height(part):
        warn(f"{height_map}: {doubt}")
    with blaming(height_map):
        if fill is not None:
            part = fill_missing(part, fill)
        solid = solid_of(part, base_um=base_um, min_thickness_um=min_thickness_um)
        error_um = 0.0
        if max_faces is not None and len(solid.faces) > max_faces:
            solid, error_um = merged(solid, part, max_faces, max_error_um, base_um, min_thickness_um)
    with blaming(output), replacing(output) as temporary:
        write_solid(temporary, solid)
    draw(plot, lambda plots: plots.overview(part, name=output.stem, caption=part.summary()))
    for remark in solid.remarks:
        warn(f"{height_map}: {remark}")
    (x0, y0, _), (x1, y1, top) = solid.vertices_um.min(axis=0), solid.vertices_um.max(axis=0)
    within = f" within {1e3 * error_um:.3g} nm" if error_um else ""
    tell(
        {
            "triangles": len(solid.faces),
            "surface_error_um": error_um,
            "x_um": (x0, x1),
            "y_um": (y0, y1),
            "z_um": (0.0, top),
            "volume_um3": solid.volume_um3,
            "lifted_points": solid.lifted_points,
            "largest_lift_um": solid.largest_lift_um,
        }
    )
    say(
        f"{output}: watertight, {len(solid.faces)} triangles{within}, x {x0:.5g} to {x1:.5g}, y {y0:.5g} to {y1:.5g}, "
        f"z 0 to {top:.4g} µm, volume {solid.volume_um3:.6g} µm³"
    )
