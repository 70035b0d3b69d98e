"""Does an import look like a microscope's field? Catches metres taken for µm and clipped heights, not finer slips."""

from __future__ import annotations

import numpy as np

from dlwpredict.heightmap import HeightMap

FIELD_UM = (10.0, 1e4)
Z_RANGE_UM = (0.01, 1e3)
CLIPPED_SHARE, CLIPPED_POINTS = 1e-4, 10
WRITTEN_SUBSTRATE = 0.05  # share of points at exactly 0, which no microscope gives: a design, not a recording
CONTINUOUS_HEIGHTS = 1000  # different ones, from which a map is more than a design of few levels


def plausibility(height_map: HeightMap) -> list[str]:
    """Return a warning for each size that no usual recording has.

    Usual are fields of 10 µm to 10 mm and height ranges of 10 nm to 1 mm, and that hardly two points share the
    lowest or the highest height; 0 is left out, where a design has nothing.

    Examples
    --------
    >>> plausibility(HeightMap([[0.0, 5e-7]] * 200, dx_um=10, dy_um=0.1))
    ['z range 5e-07 µm, usual 0.01 to 1000 µm: is the unit right (--z-scale)?']
    """
    warnings = []
    for axis, extent in zip("xy", height_map.size_um, strict=True):
        if not FIELD_UM[0] <= extent <= FIELD_UM[1]:
            warnings.append(f"field {extent:.4g} µm in {axis}, usual 10 to 10000 µm: is the pitch right (--pitch-um)?")
    heights = height_map.heights_um[~np.isnan(height_map.heights_um)]
    z_range = float(heights.max() - heights.min())
    if not Z_RANGE_UM[0] <= z_range <= Z_RANGE_UM[1]:
        warnings.append(f"z range {z_range:.4g} µm, usual 0.01 to 1000 µm: is the unit right (--z-scale)?")
    return warnings + clipping(height_map)


def clipping(height_map: HeightMap) -> list[str]:
    """Return a warning where the lowest or the highest height of a recording stands at many points.

    0, the substrate, is left out; a map with much of it is a design, whose highest points may well be alike.
    """
    heights, warnings = height_map.heights_um[~np.isnan(height_map.heights_um)], []
    if np.mean(heights == 0) > WRITTEN_SUBSTRATE:
        return []
    for name, end in (("lowest", heights.min()), ("highest", heights.max())):
        points = int((heights == end).sum())
        many = end != 0 and points >= CLIPPED_POINTS and points > CLIPPED_SHARE * heights.size
        if many and np.unique(heights).size > CONTINUOUS_HEIGHTS:
            warnings.append(f"{points} points at the {name} height, {end:.4g} µm: is the recording clipped?")
    return warnings


def tilt_mrad(height_map: HeightMap) -> tuple[float, float]:
    """Return the slopes along x and y (up) of the plane of least squares through the measured points, mrad.

    Examples
    --------
    >>> plane = HeightMap(np.add.outer([0.2, 0.0], [0.0, 0.1, 0.2]), dx_um=100, dy_um=100)
    >>> [round(slope, 6) for slope in tilt_mrad(plane)]
    [1.0, 2.0]
    """
    known = ~np.isnan(height_map.heights_um)
    heights = np.where(known, height_map.heights_um, 0.0)
    x, y, in_col, in_row = height_map.x_um, height_map.y_um, known.sum(0), known.sum(1)
    xy = y @ (known @ x)
    products = [
        [in_col.sum(), in_col @ x, in_row @ y],
        [in_col @ x, in_col @ x**2, xy],
        [in_row @ y, xy, in_row @ y**2],
    ]
    right = [heights.sum(), heights.sum(0) @ x, heights.sum(1) @ y]
    _, along_x, along_y = np.linalg.lstsq(np.array(products), np.array(right), rcond=None)[0]
    return 1e3 * float(along_x), 1e3 * float(along_y)
