"""What to put where nothing was measured, for outputs that know no NaN."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import distance_transform_edt

from dlwpredict.errors import InputError
from dlwpredict.heightmap import HeightMap


def fill_missing(height_map: HeightMap, how: str) -> HeightMap:
    """Fill every NaN, marking the points as filled.

    Parameters
    ----------
    height_map : HeightMap
        Heights, µm, shape (rows, cols).
    how : str
        "zero", "nearest" (the height of the nearest known point, distances in µm) or a number of µm.

    Raises
    ------
    InputError
        ``how`` is none of these, or no height is known to take over.

    Examples
    --------
    >>> part = HeightMap([[1.0, np.nan], [3.0, np.nan]], dx_um=0.1, dy_um=0.3)
    >>> fill_missing(part, "nearest").heights_um.tolist()
    [[1.0, 1.0], [3.0, 3.0]]
    """
    heights = height_map.heights_um
    missing = np.isnan(heights)
    if how == "nearest":
        if missing.all():
            raise InputError("no measured point to take over", key="--fill", allowed="allowed: zero or a height in µm")
        sampling = (height_map.dy_um, height_map.dx_um)
        source = distance_transform_edt(missing, sampling=sampling, return_distances=False, return_indices=True)
        values = heights[tuple(source)]
    else:
        values = np.where(missing, _height(how), heights)
    filled = missing if height_map.filled is None else missing | height_map.filled
    return replace(height_map, heights_um=values, filled=filled)


def _height(how: str) -> float:
    try:
        value = 0.0 if how == "zero" else float(how)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise InputError(f"found {how}", key="--fill", allowed="allowed: zero, nearest, or a height in µm")
    return value
