"""``predict`` for maps too large to be computed at once."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from dlwpredict.cli.console import detail, progress_shown, say
from dlwpredict.cli.streams import tell
from dlwpredict.errors import InputError, ResultError, blaming
from dlwpredict.files import read_height_map, write_height_map
from dlwpredict.files.mapped_tiff import Mapped, mapped, mapping
from dlwpredict.files.provenance import note_input
from dlwpredict.heightmap import HeightMap
from dlwpredict.parameters import ParameterSet
from dlwpredict.tiling.large import WHOLE_PX, Large, canvas_of, tile_side_px

LEAST_TILE_PX = 64

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


def cut(target: Path, tile_px: int | None, scheduler: str | None) -> Mapped | None:
    """Open a target that is to be cut into tiles; None for one that is computed at once.

    Raises
    ------
    InputError
        A tile too small to be sensible, or a target that cannot be read.
    """
    if tile_px is not None and 0 < tile_px < LEAST_TILE_PX:
        raise InputError(f"found {tile_px}", key="--tile-px", allowed=f"allowed: 0, or {LEAST_TILE_PX} and more")
    if tile_px == 0:
        return None
    source = mapped(target)
    if source is None and (tile_px or scheduler):
        part = read_height_map(target)
        source = Mapped(part.heights_um, part.dx_um, part.dy_um)
    if source is None or not (tile_px or scheduler or source.heights_um.size > WHOLE_PX):
        return None
    note_input(target)
    return source


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
    with _on_disk(source, target, folder) as path, blaming(target):
        canvas, highest_um = canvas_of(path, source.heights_um, source.dx_um, source.dy_um, process)
        side = tile_px or tile_side_px(canvas, process, highest_um)
        detail(f"target: {cols} x {rows} px, tiles of at most {side} px")
        with _progress() as on_tile, _kept(output, folder):
            large = Large(canvas, process, side, as_measured, 1 if scheduler else threads, scheduler, on_tile)
            low, high = _written(large, output, folder)
    shutil.rmtree(folder)
    figures = {"rows": rows, "cols": cols, "pitch_um": (source.dx_um, source.dy_um), "z_um": (low, high)}
    say(
        f"{output}: {cols} x {rows} px, pitch {source.dx_um:.6g} x {source.dy_um:.6g} µm, "
        f"z {low:.4g} to {high:.4g} µm, in tiles of at most {side} px"
    )
    tell({**figures, "tile_px": side})


def _written(large: Large, output: Path, folder: Path) -> tuple[float, float]:
    """Predict into the output; return its lowest and highest height, µm."""
    canvas = large.canvas
    shape, dx_um, dy_um = canvas.target_shape, canvas.dx_um, canvas.dy_um
    if output.suffix.lower() in (".tif", ".tiff"):
        with mapping(output, shape, dx_um, dy_um) as printed:
            large.predict(folder, printed)
            return float(printed.min()), float(printed.max())
    heights = np.zeros(shape)
    large.predict(folder, heights)
    write_height_map(output, HeightMap(heights, dx_um, dy_um))
    return float(heights.min()), float(heights.max())


@contextmanager
def _on_disk(source: Mapped, target: Path, folder: Path) -> Iterator[Path]:
    """Yield the file from which the workers read the target: itself, or a copy where its format cannot be mapped."""
    if isinstance(source.heights_um, np.memmap):
        yield target.resolve()
        return
    copy = folder.with_suffix(".npy")
    np.save(copy, source.heights_um)
    try:
        yield copy
    finally:
        copy.unlink(missing_ok=True)


@contextmanager
def _kept(output: Path, folder: Path) -> Iterator[None]:
    """Say, on Ctrl-C, that nothing finished is lost."""
    try:
        yield
    except KeyboardInterrupt:
        raise ResultError(
            "interrupted", where=output, allowed=f"the same command goes on with the tiles in {folder.name}"
        ) from None


@contextmanager
def _progress() -> Iterator[Callable[[int, int], None]]:
    """Show how many tiles are done, on a terminal only."""
    if not progress_shown():
        yield lambda done, count: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = TextColumn("predicting"), BarColumn(), MofNCompleteColumn(), TextColumn("tiles"), TimeElapsedColumn()
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("", total=None)
        yield lambda done, count: bar.update(task, completed=done, total=count)
