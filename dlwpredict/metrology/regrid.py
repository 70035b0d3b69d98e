"""A map cut, widened, smoothed, or brought to a coarser grid by hand: means over area, of what was measured."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import ndimage, sparse

from dlwpredict.errors import InputError
from dlwpredict.heightmap import HeightMap
from dlwpredict.numerics.smoothing import FWHM_PER_SIGMA

MEASURED = 0.5
"""Share of a pixel's area that must have been measured."""

WIDEST = 10.0
"""Widest margin, and widest Gaussian, in larger sides of the map."""


def cropped(height_map: HeightMap, x_um: tuple[float, float], y_um: tuple[float, float]) -> HeightMap:
    """Return the pixels whose centres lie in a rectangle, µm from the centre of the map, y upwards.

    Raises
    ------
    InputError
        Fewer than two rows or columns are left.

    Examples
    --------
    >>> part = HeightMap(np.arange(16.0).reshape(4, 4), dx_um=1.0, dy_um=1.0)
    >>> cropped(part, (0, 2), (-2, 0)).heights_um.tolist()
    [[10.0, 11.0], [14.0, 15.0]]
    """
    cols = (height_map.x_um >= min(x_um)) & (height_map.x_um <= max(x_um))
    rows = (height_map.y_um >= min(y_um)) & (height_map.y_um <= max(y_um))
    if min(rows.sum(), cols.sum()) < 2:
        x, y = (f"{-size / 2:g} to {size / 2:g} µm" for size in height_map.size_um)
        raise InputError(
            f"{int(rows.sum())} rows and {int(cols.sum())} columns are left",
            key="--crop",
            allowed=f"at least two of each: X0 Y0 X1 Y1 are two corners; the map has x from {x} and y from {y}",
        )
    filled = None if height_map.filled is None else height_map.filled[np.ix_(rows, cols)]
    return replace(height_map, heights_um=height_map.heights_um[np.ix_(rows, cols)], filled=filled)


def widened(height_map: HeightMap, margin_um: float) -> HeightMap:
    """Return the map with bare substrate, height 0, at least so wide on every side.

    Raises
    ------
    InputError
        The margin is not within what is allowed.

    Examples
    --------
    >>> part = HeightMap([[1.0, 2.0], [3.0, 4.0]], dx_um=1.0, dy_um=0.5)
    >>> widened(part, 1.0).shape, float(widened(part, 1.0).heights_um[2, 1])
    ((6, 4), 1.0)
    """
    _require_width(height_map, margin_um, "--margin-um")
    pixels = [int(np.ceil(margin_um / pitch - 1e-9)) for pitch in (height_map.dy_um, height_map.dx_um)]
    sides = [(count, count) for count in pixels]
    filled = None if height_map.filled is None else np.pad(height_map.filled, sides)
    return replace(height_map, heights_um=np.pad(height_map.heights_um, sides), filled=filled)


def smoothed(height_map: HeightMap, fwhm_um: float) -> HeightMap:
    """Return the map under a Gaussian, the mean of what was measured within it; what was not measured stays so.

    Raises
    ------
    InputError
        The width is not within what is allowed.

    Examples
    --------
    >>> part = HeightMap([[0.0, np.nan, 2.0, 2.0]] * 4, dx_um=1.0, dy_um=1.0)
    >>> smoothed(part, 2.0).heights_um[0].round(2).tolist()
    [0.08, nan, 1.92, 2.0]
    """
    _require_width(height_map, fwhm_um, "--smooth-um")
    sigmas = [fwhm_um / FWHM_PER_SIGMA / pitch for pitch in (height_map.dy_um, height_map.dx_um)]
    known = ~np.isnan(height_map.heights_um)
    values = np.where(known, height_map.heights_um, 0.0)
    above, below = (ndimage.gaussian_filter(part, sigmas, mode="nearest") for part in (values, known.astype(float)))
    return height_map.with_heights(np.where(known, above / np.maximum(below, 1e-12), np.nan))


def resampled(height_map: HeightMap, pitch_um: float) -> HeightMap:
    """Return the map on square pixels of another pitch, each the mean over its area of what was measured there.

    The centre of the map stays where it is; what does not fill a pixel at the rim is left out.

    Raises
    ------
    InputError
        The pitch is finer than the map's, or leaves fewer than two rows or columns.

    Examples
    --------
    >>> part = HeightMap([[0.0, 1.0, 2.0, 3.0], [0.0, 1.0, np.nan, np.nan]] * 2, dx_um=1.0, dy_um=1.0)
    >>> resampled(part, 2.0).heights_um.tolist()
    [[0.5, 2.5], [0.5, 2.5]]
    """
    finest = max(height_map.dx_um, height_map.dy_um)
    if not pitch_um >= finest * (1 - 1e-9):
        raise InputError(f"found {pitch_um:g} µm", key="--resample-um", allowed=f"at least the map's own {finest:g} µm")
    down, across = (
        _overlaps(n, own_um, pitch_um)
        for n, own_um in zip(height_map.shape, (height_map.dy_um, height_map.dx_um), strict=True)
    )
    if min(down.shape[0], across.shape[0]) < 2:
        width, height = height_map.size_um
        raise InputError(
            f"found {pitch_um:g} µm for a map of {width:g} x {height:g} µm",
            key="--resample-um",
            allowed="at least two rows and columns",
        )

    def mean(values: np.ndarray) -> np.ndarray:
        return down @ (across @ values.T).T

    there = ~np.isnan(height_map.heights_um)
    known = mean(there.astype(float))
    heights = mean(np.where(there, height_map.heights_um, 0.0)) / np.maximum(known, 1e-12)
    filled = None if height_map.filled is None else mean(height_map.filled.astype(float)) > 1 - MEASURED
    values = np.where(known >= MEASURED - 1e-9, heights, np.nan)
    return replace(height_map, heights_um=values, dx_um=pitch_um, dy_um=pitch_um, filled=filled)


def _require_width(height_map: HeightMap, width_um: float, key: str) -> None:
    widest = WIDEST * max(height_map.size_um)
    if not 0 < width_um <= widest:
        raise InputError(f"found {width_um:g} µm", key=key, allowed=f"allowed: above 0, to {widest:g} µm for this map")


def _overlaps(count: int, own_um: float, pitch_um: float) -> sparse.csr_array:
    """Return the share of each wide pixel that each of the map's covers, shape (wide, count), rows of sum 1."""
    wide = int(np.floor(count * own_um / pitch_um + 1e-9))
    starts = (count * own_um - wide * pitch_um) / 2 + pitch_um * np.arange(wide)
    places = np.arange(count) * own_um
    shared = np.minimum(starts[:, None] + pitch_um, places + own_um) - np.maximum(starts[:, None], places)
    return sparse.csr_array(np.maximum(shared, 0.0) / pitch_um)
