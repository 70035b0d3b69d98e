"""``predict`` for maps too large to be computed at once."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from dlwpredict.cli.console import counted, detail, say
from dlwpredict.cli.streams import tell
from dlwpredict.errors import InterruptionError, blaming
from dlwpredict.files.mapped_tiff import Mapped
from dlwpredict.parameters import ParameterSet
from dlwpredict.tiling.disk import on_disk, written
from dlwpredict.tiling.large import WHOLE_PX, Large, canvas_of, tile_side_px

TilePx = Annotated[
    int | None,
    typer.Option(
        "--tile-px",
        help=f"Largest side of a tile; 0 = the whole map at once. Maps above {WHOLE_PX / 1e6:g} million points are cut "
        "by themselves.",
        min=0,
    ),
]
Scheduler = Annotated[
    str | None,
    typer.Option("--scheduler", metavar="ADDRESS", help="Dask scheduler whose workers compute, as tcp://host:8786."),
]


def predict_large(
    source: Mapped,
    target: Path,
    output: Path,
    process: ParameterSet,
    tile_px: int | None,
    as_measured: bool,
    threads: int,
    scheduler: str | None,
) -> None:
    """Predict tile by tile; what is finished stays beside the output until the map is whole."""
    rows, cols = source.heights_um.shape
    folder = output.resolve().with_name(f".{output.name}.tiles")
    with on_disk(source, target, folder) as path, blaming(target):
        canvas, highest_um = canvas_of(path, source.heights_um, source.dx_um, source.dy_um, process)
        side = tile_px or tile_side_px(canvas, process, highest_um)
        detail(f"target: {cols} x {rows} px, tiles of at most {side} px")
        with counted("predicting", "tiles") as on_tile, _kept(output, folder):
            large = Large(canvas, process, side, as_measured, 1 if scheduler else threads, scheduler, on_tile)
            low, high = written(large, output, folder)
    shutil.rmtree(folder)
    figures = {"rows": rows, "cols": cols, "pitch_um": (source.dx_um, source.dy_um), "z_um": (low, high)}
    say(
        f"{output}: {cols} x {rows} px, pitch {source.dx_um:.6g} x {source.dy_um:.6g} µm, "
        f"z {low:.4g} to {high:.4g} µm, in tiles of at most {side} px"
    )
    tell({**figures, "tile_px": side})


@contextmanager
def _kept(output: Path, folder: Path) -> Iterator[None]:
    """Say, on Ctrl-C, that nothing finished is lost."""
    try:
        yield
    except KeyboardInterrupt:
        raise InterruptionError(
            "interrupted", where=output, allowed=f"the same command goes on with the tiles in {folder.name}"
        ) from None
