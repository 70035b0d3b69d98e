"""Large maps from file to file: whether a target is to be cut, and where its heights and its print lie on disk."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from dlwpredict.errors import InputError
from dlwpredict.files import read_height_map, write_height_map
from dlwpredict.files.mapped_tiff import Mapped, mapped, mapping
from dlwpredict.files.provenance import note_input
from dlwpredict.heightmap import HeightMap
from dlwpredict.tiling.large import WHOLE_PX, Large

LEAST_TILE_PX = 64


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


@contextmanager
def on_disk(source: Mapped, target: Path, folder: Path) -> Iterator[Path]:
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


def written(large: Large, output: Path, folder: Path) -> tuple[float, float]:
    """Predict into the output, the tiles kept in the folder; return its lowest and highest height, µm."""
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
