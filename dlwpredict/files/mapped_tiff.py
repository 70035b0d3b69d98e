"""Large height maps in TIFF, read and written in place on disk: only what is touched takes memory.

The library is imported where it is used: `predict --help` need not wait for it.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dlwpredict.errors import InputError, blaming
from dlwpredict.files.atomic import replacing
from dlwpredict.files.key_lines import key_lines, parse_lines, stored_facts
from dlwpredict.heightmap import HeightMap

MOST_BYTES = 4_000_000_000
"""Largest picture; the places in a TIFF are numbers of 32 bits."""


@dataclass(frozen=True, eq=False)
class Mapped:
    """Heights on disk, µm, and their grid.

    Parameters
    ----------
    heights_um : numpy.memmap, shape (rows, cols)
    dx_um, dy_um : float
    """

    heights_um: np.ndarray
    dx_um: float
    dy_um: float


def mapped(path: Path) -> Mapped | None:
    """Open a TIFF that holds its heights in µm as one plain block and states its pitch; None for any other file.

    Raises
    ------
    InputError
        Faulty lines in the description.
    """
    if path.suffix.lower() not in (".tif", ".tiff") or not path.is_file():
        return None
    import tifffile

    try:
        with tifffile.TiffFile(path) as file:
            page, alone = file.pages.first, len(file.series) == 1
            real = page.dtype is not None and page.dtype.kind == "f"
            plain = page.is_memmappable and real and len(file.series[0].shape) == 2
            upright = page.tags.valueof("Orientation", 1) == 1
            description = page.description
        heights = tifffile.memmap(path, mode="r") if alone and plain and upright else None
    except Exception:  # tifffile meets broken files with errors of every kind; the usual reader says which
        return None
    with blaming(path):
        facts = stored_facts(parse_lines(description))
    if heights is None or min(heights.shape) < 2 or "pitch_um" not in facts or facts.get("z_unit", "um") != "um":
        return None
    return Mapped(heights, *facts["pitch_um"])


@contextmanager
def mapping(path: Path, shape: tuple[int, int], dx_um: float, dy_um: float) -> Iterator[np.ndarray]:
    """Yield the heights (rows, cols) of a new TIFF, to be filled in place; the file is whole or absent afterwards.

    Raises
    ------
    InputError
        The picture would exceed what a TIFF can hold, or the folder is not writable.
    """
    if 4 * shape[0] * shape[1] > MOST_BYTES:
        raise InputError(f"{shape[1]} x {shape[0]} px", where=path, key="size", allowed="allowed up to 31622 x 31622")
    import tifffile

    with replacing(path) as temporary:
        heights = tifffile.memmap(
            temporary,
            shape=shape,
            dtype="<f4",
            imagej=True,
            resolution=(1 / dx_um, 1 / dy_um),
            metadata={"unit": "um", **key_lines(HeightMap(np.zeros((2, 2)), dx_um, dy_um))},
            software="dlwpredict",
        )
        yield heights
        heights.flush()
        del heights
