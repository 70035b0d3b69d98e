"""The recording on the target's grid: averaged where it is finer, interpolated where it is coarser."""

from __future__ import annotations

import numpy as np

from dlwpredict.align.fill import extend, fill
from dlwpredict.align.pose import Pose
from dlwpredict.align.surface import Surface
from dlwpredict.heightmap import HeightMap


def prepared(recording: HeightMap, measured: np.ndarray) -> Surface:
    """Fill a recording's gaps, and extend it beyond its hull without support (for filters only)."""
    heights = extend(fill(recording.heights_um, measured))
    return Surface(heights, measured.astype(float), recording.dx_um, recording.dy_um)


def resample(surface: Surface, hull: np.ndarray, target: HeightMap, pose: Pose) -> HeightMap:
    """Bring a recording onto the target's grid.

    Each target point is the mean over its pixel, read at n × n places no farther apart than the recording's own
    pitch: by a cubic spline for n ≤ 2 (n = 1, plain interpolation, where the recording is as coarse as the target),
    linearly beyond. Less than half of a pixel measured: marked as filled. Less than half of it inside the measured
    hull: NaN.

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
    counts = [
        max(1, int(np.ceil(d * s / fine - 0.05))) for d, s in zip((target.dx_um, target.dy_um), pose.scale, strict=True)
    ]
    reach = Surface(hull.astype(float), hull.astype(float), surface.dx_um, surface.dy_um)
    total, measured, within = np.zeros((3, *x.shape))
    for i in range(counts[0]):
        for j in range(counts[1]):
            right = ((i + 0.5) / counts[0] - 0.5) * target.dx_um
            up = ((j + 0.5) / counts[1] - 0.5) * target.dy_um
            place = pose.to_recording(x + right, y + up)
            heights, support = surface.at(*place, order=3 if max(counts) < 3 else 1)
            total, measured = total + heights, measured + support
            within = within + reach.at(*place, order=1)[1]
    number = counts[0] * counts[1]
    heights = np.where(within >= 0.5 * number, total / number, np.nan)
    return HeightMap(heights, target.dx_um, target.dy_um, filled=(measured < 0.5 * number) & ~np.isnan(heights))
