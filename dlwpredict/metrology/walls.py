"""Where walls stand: no honest figure is taken there."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from dlwpredict.heightmap import HeightMap
from dlwpredict.metrology.missing import fill_missing

WALL_PX = 3
"""Points this near to a wall do not count. The wall's place is known to a pixel only, and two honest discretisations
of the same physics differ there by 20–30 nm and more."""

JUMP_UM, JUMP_SLOPE = 0.2, 1.0
"""A wall is a jump between neighbours that exceeds what the slope around explains by this much, and by this slope."""

RESOLVED, NEIGHBOURS = 0.25, np.array([1, -6, 15, 0, 15, -6, 1]) / 20
"""Pixels do not resolve a wall where a height is off what its six neighbours along a line tell (a quintic) by more
than this share of a wall's least jump: a step of twice that. They resolve a wave of seven pixels."""

SMEARED_PX = 2
"""An instrument's blur smears a wall over so many pixels to either side; its place is where the jump is largest."""


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
    return _within(wall_px, _walls(np.pad(part.heights_um, 3), part)[3:-3, 3:-3])


def near_unresolved_walls(part: HeightMap, wall_px: int = WALL_PX) -> np.ndarray:
    """Return True within ``wall_px`` pixels of a wall that is no steep flank of a surface, shape (rows, cols).

    Examples
    --------
    >>> x = np.arange(40)
    >>> wave = HeightMap(3 + np.cos(2 * np.pi * x / 7) * np.ones((19, 1)), 0.4, 0.4)
    >>> int(near_walls(wave)[9, 6:-6].sum()), int(near_unresolved_walls(wave)[9, 6:-6].sum())
    (28, 0)
    """
    heights = np.pad(part.heights_um, 3)
    told = [ndimage.correlate1d(heights, NEIGHBOURS, axis=axis) for axis in (0, 1)]
    off = np.max(np.abs(heights - told), axis=0)
    least = RESOLVED * max(JUMP_UM, JUMP_SLOPE * min(part.dx_um, part.dy_um))
    return _within(wall_px, (_walls(heights, part) & (off > least))[3:-3, 3:-3])


def near_walls_of_both(part: HeightMap, recording: HeightMap, wall_px: int = WALL_PX) -> np.ndarray:
    """Return True within ``wall_px`` pixels of a wall of a part, wherever it was printed, shape (rows, cols).

    Shrinkage and misregistration lay a recorded wall beside that of the target. A wall that the recording shows more
    than a pixel beside one of the part counts as well: it is the part's where what is near to both meets. Any other,
    that of a particle for example, is a finding. Lone points and single lines are no walls.

    Examples
    --------
    >>> step = HeightMap(np.repeat([[0.0] * 4 + [5.0] * 12], 9, axis=0), 0.3, 0.3)
    >>> shrunk = HeightMap(np.repeat([[0.0] * 6 + [5.0] * 10], 9, axis=0), 0.3, 0.3)
    >>> near_walls_of_both(step, shrunk, 2)[4].astype(int).tolist()
    [0, 0, 1, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0, 0, 1, 1]
    """
    near = near_walls(part, wall_px)
    if not wall_px or not recording.measured.any():
        return near
    heights = ndimage.median_filter(fill_missing(recording, "nearest").heights_um, 3, mode="nearest")
    shown = _walls(np.pad(heights, 3, mode="edge"), recording, SMEARED_PX)[3:-3, 3:-3]
    rims = _within(wall_px, shown)
    moved = shown & ndimage.binary_propagation(near & rims, mask=rims) & ~near_walls(part, 2)
    return near | _within(wall_px, moved)


def _walls(heights_um: np.ndarray, grid: HeightMap, smeared_px: int = 0) -> np.ndarray:
    """Return True on both sides of a jump of heights on the pixels of a grid, of the heights' shape.

    Of a wall that is smeared over several pixels only the largest jump so near to another is one.
    """
    walls = np.zeros(heights_um.shape, dtype=bool)
    for axis, pitch in ((0, grid.dy_um), (1, grid.dx_um)):
        jump = np.nan_to_num(np.diff(heights_um, axis=axis))
        window = [5 if a == axis else 1 for a in (0, 1)]
        excess = np.abs(jump - ndimage.median_filter(jump, size=window, mode="nearest"))
        around = [2 * smeared_px + 1 if a == axis else 1 for a in (0, 1)]
        largest = np.abs(jump) >= ndimage.maximum_filter(np.abs(jump), size=around, mode="nearest")
        steep = (excess > max(JUMP_UM, JUMP_SLOPE * pitch)) & largest
        before, after = (tuple(s if a == axis else slice(None) for a in (0, 1)) for s in (slice(-1), slice(1, None)))
        walls[before] |= steep
        walls[after] |= steep
    return walls


def _within(wall_px: int, walls: np.ndarray) -> np.ndarray:
    """Return True within so many pixels of a wall, its own counted; nowhere for 0."""
    return ndimage.binary_dilation(walls, iterations=wall_px - 1) if wall_px > 1 else walls & (wall_px > 0)


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
