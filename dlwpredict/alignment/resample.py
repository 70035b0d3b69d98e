"""The recording on the target's grid: averaged where it is finer, interpolated where it is coarser."""

from __future__ import annotations

from itertools import product

import numpy as np

from dlwpredict.alignment.fill import extend, fill
from dlwpredict.alignment.pose import Pose
from dlwpredict.alignment.surface import Surface
from dlwpredict.heightmap import HeightMap


def prepared(recording: HeightMap, measured: np.ndarray) -> Surface:
    """Fill a recording's gaps, and extend it beyond its hull without support (for filters only)."""
    heights = extend(fill(recording.heights_um, measured))
    return Surface(heights, measured.astype(float), recording.dx_um, recording.dy_um)


def resample(surface: Surface, hull: np.ndarray, target: HeightMap, pose: Pose) -> HeightMap:
    """Bring a recording onto the target's grid.

    Each target point is the mean over its pixel, read at n × n places no farther apart than the recording's own
    pitch: by cubic convolution for n ≤ 2, linearly beyond. Neither takes pixels farther away than two: a wall leaves
    no trace beyond. A pixel of the recording is a mean already; so the places share a width w that gives the whole the
    variance of the target's pixel, p²/12 = q²/12 + w²/12·(1 − 1/n²), with p and q the pitches: w = p where p = n·q,
    none where the recording is as coarse as the target. Less than half of a pixel measured: marked as filled. Less than
    half of it inside the measured hull: NaN.

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
    fine = min(surface.dx_um, surface.dy_um)
    along_x, along_y = (
        _places_um(pitch, fine / scale) for pitch, scale in zip((target.dx_um, target.dy_um), pose.scale, strict=True)
    )
    how = "local" if max(len(along_x), len(along_y)) < 3 else "linear"
    reach = Surface(hull.astype(float), hull.astype(float), surface.dx_um, surface.dy_um)
    total, measured, within = np.zeros((3, *x.shape))
    for right, up in product(along_x, along_y):
        place = pose.to_recording(x + right, y + up)
        heights, support = surface.at(*place, how)
        total, measured = total + heights, measured + support
        within = within + reach.at(*place, "linear")[1]
    number = len(along_x) * len(along_y)
    heights = np.where(within >= 0.5 * number, total / number, np.nan)
    return HeightMap(heights, target.dx_um, target.dy_um, filled=(measured < 0.5 * number) & ~np.isnan(heights))


def _places_um(pitch_um: float, fine_um: float) -> np.ndarray:
    """Return where along one axis a pixel is read, from its centre, pixels of the recording being means over theirs.

    Examples
    --------
    >>> _places_um(0.4, 0.2), _places_um(0.4, 0.4), _places_um(0.4, 0.35).round(3)
    (array([-0.1,  0.1]), array([0.]), array([-0.056,  0.056]))
    """
    count = max(1, int(np.ceil(pitch_um / fine_um - 0.05)))
    if count == 1:
        return np.zeros(1)
    width = np.sqrt(max(pitch_um**2 - fine_um**2, 0) / (1 - count**-2))
    return ((np.arange(count) + 0.5) / count - 0.5) * width
