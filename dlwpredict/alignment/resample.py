"""The recording on the target's grid: means over its pixels from means over the recording's."""

from __future__ import annotations

from itertools import product

import numpy as np

from dlwpredict.alignment.fill import extend, fill
from dlwpredict.alignment.pose import Pose
from dlwpredict.alignment.surface import Surface
from dlwpredict.heightmap import HeightMap

MOST_PX, ROUNDING = 2.0, 1e-6
"""Pixels of the recording that one piece of a target's pixel may be wide."""


def prepared(recording: HeightMap, measured: np.ndarray) -> Surface:
    """Fill a recording's gaps, and extend it beyond its hull without support (for filters only)."""
    heights = extend(fill(recording.heights_um, measured))
    return Surface(heights, measured.astype(float), recording.dx_um, recording.dy_um)


def resample(surface: Surface, hull: np.ndarray, target: HeightMap, pose: Pose) -> HeightMap:
    """Bring a recording onto the target's grid.

    Each target point is the mean over its pixel, read off the recording's pixels, which are means over theirs: in one
    piece, or in n × n where the pixel is wider than two of the recording's. No piece takes pixels farther away than
    three, beside walls two: a wall leaves no trace beyond. Less than half of a pixel measured: marked as filled. Less
    than half of it inside the measured hull: NaN.

    Parameters
    ----------
    surface : Surface
        Recording, turned back already if mirrored.
    hull : numpy.ndarray of bool
        Points of the recording inside the hull of what was measured.
    target : HeightMap
        Gives the grid.
    pose : Pose
    """
    x, y = np.meshgrid(target.x_um, target.y_um)
    side_um = _sides_um(target, pose)
    number = int(np.ceil(max(side_um[0] / surface.dx_um, side_um[1] / surface.dy_um) / MOST_PX - ROUNDING))
    piece_um = side_um[0] / number, side_um[1] / number
    reach = Surface(hull.astype(float), hull.astype(float), surface.dx_um, surface.dy_um)
    total, measured, within = np.zeros((3, *x.shape))
    pieces = (np.arange(number) - (number - 1) / 2) / number
    for right, up in product(pieces * target.dx_um, pieces * target.dy_um):
        place = pose.to_recording(x + right, y + up)
        heights, support = surface.mean_at(*place, piece_um)
        total, measured = total + heights, measured + support
        within = within + reach.at(*place, "linear")[1]
    heights = np.where(within >= 0.5 * number**2, total / number**2, np.nan)
    return HeightMap(heights, target.dx_um, target.dy_um, filled=(measured < 0.5 * number**2) & ~np.isnan(heights))


def _sides_um(target: HeightMap, pose: Pose) -> tuple[float, float]:
    """Return the sides of an upright rectangle that varies along the recording's x and y as the target's pixel does.

    Examples
    --------
    >>> _sides_um(HeightMap(np.zeros((4, 4)), 0.2, 0.4), Pose.rigid((0.0, 0.0), 90.0))
    (0.4, 0.2)
    """
    turn, scale = np.radians(pose.rotation_deg), pose.scale
    cos, sin = np.cos(turn), np.sin(turn)
    along, across = target.dx_um * scale[0], target.dy_um * scale[1]
    return float(np.hypot(along * cos, across * sin)), float(np.hypot(along * sin, across * cos))
