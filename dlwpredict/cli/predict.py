"""``dlwpredict predict``: the printed surface of a target."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from dlwpredict.api.predict import predict
from dlwpredict.cli import options
from dlwpredict.cli.console import detail, say, warn
from dlwpredict.cli.large import Scheduler, TilePx, predict_large
from dlwpredict.cli.plotting import Plot, check_plot, draw
from dlwpredict.cli.streams import figures_of, tell
from dlwpredict.correction.surround import doubt_of_edges
from dlwpredict.errors import InputError, blaming
from dlwpredict.files import read_height_map, write_height_map
from dlwpredict.files.parameters_yaml import read_parameters
from dlwpredict.files.plausibility import unusual_height
from dlwpredict.model.levels import Levels
from dlwpredict.model.states import Numerics
from dlwpredict.model.voxels import Voxels
from dlwpredict.tiling.disk import cut

COMMAND = "predict"
FIGURES = True


class Method(StrEnum):
    """How to compute."""

    fast = "fast"
    voxel = "voxel"


def run(
    target: Annotated[Path, typer.Argument(help="Height map to be written.", show_default=False)],
    output: options.Output,
    parameters: options.Parameters = None,
    method: Annotated[Method, typer.Option(help="Smooth levels, or the paper's voxels.")] = Method.fast,
    slice_um: Annotated[
        float | None,
        typer.Option(help="Height of a voxel; the slicing of the parameter file, or 0.1.", **options.LENGTH),
    ] = None,
    memory_mb: Annotated[float, typer.Option(help="Memory for the stacks of the voxel method.", min=10)] = 600.0,
    as_measured: Annotated[
        bool,
        typer.Option("--as-measured", help="Add the measurement effects: what the instrument would show."),
    ] = False,
    surround: options.SurroundOption = None,
    threads: Annotated[int, typer.Option(help="Threads of the fast method.", min=1)] = 1,
    tile_px: TilePx = None,
    scheduler: Scheduler = None,
    plot: Plot = None,
    overwrite: options.Overwrite = False,
) -> None:
    """Predict the printed surface of a target; large maps tile by tile, on disk, to be resumed where they stopped.

    $ dlwpredict predict target.tif -p process.yaml -o predicted.tif
    """
    options.check_outputs(output, plot, overwrite=overwrite)
    check_plot(plot)
    process = read_parameters(parameters)
    large = cut(target, tile_px, scheduler) if method is Method.fast else None
    if large is not None:
        if plot is not None:
            raise InputError("given for a map cut into tiles", key="--plot", allowed="allowed with --tile-px 0")
        if surround is options.Surround.continued:
            raise InputError("given for a map cut into tiles", key="--surround", allowed="allowed with --tile-px 0")
        predict_large(large, target, output, process, tile_px, as_measured, threads, scheduler)
        return
    part = read_height_map(target)
    if method is Method.voxel:
        slice_um = process.writing.slicing_um or 0.1 if slice_um is None else slice_um
        if not 0.001 <= slice_um <= 5:
            raise InputError(f"found {slice_um:g}", key="--slice-um", allowed="allowed 0.001 to 5 µm")
        numerics: Numerics = Voxels(slice_um, memory_mb)
    else:
        numerics = Levels(threads)
    for doubt in unusual_height(part):
        warn(f"{target}: {doubt}")
    detail(f"target: {part.summary()}")
    with blaming(target):
        continued = surround is options.Surround.continued
        printed = predict(part, process, as_measured=as_measured, continued=continued, numerics=numerics)
    for doubt in doubt_of_edges(part) if surround is None else ():
        warn(f"{target}: {doubt}")
    write_height_map(output, printed)
    draw(plot, lambda plots: plots.comparison(part, printed, names=("target", "prediction")))
    say(f"{output}: {printed.summary()}")
    tell(figures_of(printed))
