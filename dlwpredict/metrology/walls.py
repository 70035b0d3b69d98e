"""Where walls stand: no honest figure is taken there."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from dlwpredict.heightmap import HeightMap

WALL_PX = 3
"""Points this near to a wall do not count. The wall's place is known to a pixel only, and two honest discretisations
of the same physics differ there by 20–30 nm and more."""

JUMP_UM, JUMP_SLOPE = 0.2, 1.0
"""A wall is a jump between neighbours that exceeds what the slope around explains by this much, and by this slope."""


def near_walls(part: HeightMap, wall_px: int = WALL_PX) -> np.ndarray:
    """Return True within ``wall_px`` pixels of a wall of a part, shape (rows, cols).

    A slope that the pixels resolve changes little from one pixel to the next; at a wall the whole jump sits in one or
    two. So the jump between neighbours is compared with the median jump over five pixels along the same line.
    Beyond the map nothing is written. What lies beside a missing height (NaN) is no jump.

    Examples
    --------
    >>> step = HeightMap(np.repeat([[0.0] * 4 + [5.0] * 6 + [2.0] * 6 + [0.0] * 4], 12, axis=0), 0.1, 0.1)
    >>> near_walls(step, 2)[6].astype(int).tolist()
    [0, 0, 1, 1, 1, 1, 0, 0, 1, 1, 1, 1, 0, 0, 1, 1, 1, 1, 0, 0]
    """
    heights = np.pad(part.heights_um, 3)
    walls = np.zeros(heights.shape, dtype=bool)
    for axis, pitch in ((0, part.dy_um), (1, part.dx_um)):
        jump = np.nan_to_num(np.diff(heights, axis=axis))
        window = [5 if a == axis else 1 for a in (0, 1)]
        excess = np.abs(jump - ndimage.median_filter(jump, size=window, mode="nearest"))
        steep = excess > max(JUMP_UM, JUMP_SLOPE * pitch)
        before, after = (tuple(s if a == axis else slice(None) for a in (0, 1)) for s in (slice(-1), slice(1, None)))
        walls[before] |= steep
        walls[after] |= steep
    if wall_px > 1:
        walls = ndimage.binary_dilation(walls, iterations=wall_px - 1)
    return walls[3:-3, 3:-3] & (wall_px > 0)


def near_walls_or_rim(part: HeightMap, wall_px: int = WALL_PX) -> np.ndarray:
    """Return True within ``wall_px`` pixels of a wall or of the map's rim, shape (rows, cols).

    Beyond the map a prediction knows of no neighbours: where the map was cut out of a larger part, it falls off there.

    Examples
    --------
    >>> near_walls_or_rim(HeightMap(np.zeros((4, 5)), 1, 1), 1).astype(int).tolist()
    [[1, 1, 1, 1, 1], [1, 0, 0, 0, 1], [1, 0, 0, 0, 1], [1, 1, 1, 1, 1]]
    """
    near = near_walls(part, wall_px)
    if wall_px:
        near[:wall_px] = near[-wall_px:] = near[:, :wall_px] = near[:, -wall_px:] = True
    return near
