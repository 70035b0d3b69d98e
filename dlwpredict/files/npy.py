"""NumPy's ``.npy``: one matrix of µm, nothing else; the pitch has to be given on reading."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dlwpredict.errors import InputError
from dlwpredict.files.formats import Format, Pair, Stored, require_size, unmarked, unsaid
from dlwpredict.heightmap import HeightMap


def read_npy(path: Path, pitch_um: Pair | None) -> Stored:
    """Read a real matrix; pickled objects are never loaded.

    Raises
    ------
    InputError
        Not a ``.npy`` file, truncated, or holding anything but integers or floats.
    """
    try:
        numbers = np.lib.format.open_memmap(path, mode="r")  # takes no memory for what a header only claims
    except Exception as error:  # NumPy meets broken headers with errors of every kind
        raise InputError(
            f"not a readable .npy ({error})", key="file", allowed="needs a plain matrix of numbers"
        ) from None
    if numbers.dtype.kind not in "uif":
        raise InputError(f"values of type {numbers.dtype}", key="type", allowed="allowed: integer or float")
    require_size(*numbers.shape)
    return Stored(numbers)


def write_npy(path: Path, height_map: HeightMap) -> list[str]:
    """Write the heights in µm as float64, NaN kept."""
    with path.open("wb") as stream:
        np.lib.format.write_array(stream, height_map.heights_um, allow_pickle=False)
    pitch = f"{height_map.dx_um:g} {height_map.dy_um:g}"
    return [
        f"holds no pitch, read it with --pitch-um {pitch}",
        *unmarked(height_map),
        *unsaid(height_map, reference=True),
    ]


FORMAT = Format("NumPy matrix", (".npy",), read_npy, write_npy)
