"""Line-end pile-up: the beam is slower where a line starts and stops, and the dose is higher there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dlwpredict.effects.base import DoseEffect
from dlwpredict.effects.plane import occupied
from dlwpredict.heightmap import HeightMap
from dlwpredict.numerics.trailing import faded
from dlwpredict.parameters import declare


def from_end(on: np.ndarray, length_px: float) -> np.ndarray:
    """Return e^(−d/L), d from a pixel's centre to the end of its run of ones on the side of index 0; 0 between runs.

    Parameters
    ----------
    on : numpy.ndarray of 0 and 1, shape (rows, ...)
        Runs along the first axis.
    length_px : float
        L in pixels.

    Examples
    --------
    >>> (-np.log(from_end(np.array([0.0, 1, 1, 0, 1]), 1.0)[[1, 2, 4]])).round(9).tolist()
    [0.5, 1.5, 0.5]
    """
    first = on.copy()
    first[1:] *= 1 - on[:-1]
    return faded(float(np.exp(-0.5 / length_px)) * first, float(np.exp(-1 / length_px)) * on)


def line_end_intensity(on: np.ndarray, dy_um: float, gain: float, length_um: float, end_ratio: float) -> np.ndarray:
    """Return D = 1 + gain · (e^(−d₋/L) + end_ratio · e^(−d₊/L)) on the written segments, 1 elsewhere.

    d₋ and d₊ are the distances to the start (low y) and the end (high y) of the segment, inner gaps counting as
    ends. At constant acceleration and power the dose per length is largest where the beam is slowest.

    Parameters
    ----------
    on : numpy.ndarray of 0 and 1, shape (..., rows, cols)
        Where each layer is written; row 0 is the highest y.
    dy_um, length_um : float
        Pitch, and decay length L, µm.
    gain, end_ratio : float
    """
    half = dy_um / (2 * length_um)
    pixel_mean = float(np.sinh(half) / half)
    downwards = np.ascontiguousarray(np.moveaxis(on, -2, 0))
    starts = from_end(downwards[::-1], length_um / dy_um)[::-1]
    ends = from_end(downwards, length_um / dy_um) if end_ratio else 0
    return np.moveaxis(1 + gain * pixel_mean * (starts + end_ratio * ends), 0, -2)


@dataclass(frozen=True)
class LineEndPileup(DoseEffect):
    """More dose at the start and end of every written segment, in every layer."""

    name = "line-end-pileup"
    meaning = "too much dose where the lines start and stop: ridges on the edges that face along y"
    frame = "printer"
    source = "Lang 2022 (constant acceleration); gardner-lab/printimage (compensates beam speed)"
    confused_with = ("edge-drying", "batwings", "dose-memory", "line-length-error")
    separated_by = "edges along x against edges along y on one part of two heights, or a series of scan speeds"
    isotropic = False

    gain: float = declare(0.0, "1", 0.0, 1.0, "additional intensity at the start of a line", typical=0.15)
    length_um: float = declare(2.0, "µm", 0.2, 20, "distance over which it decays")
    end_ratio: float = declare(1.0, "1", 0.0, 1.0, "gain at the end of a line over that at its start")

    def intensity(self, written: HeightMap, z_um: float | np.ndarray) -> np.ndarray:
        """Return D of the segments written at height z."""
        on = occupied(written, z_um)
        return line_end_intensity(on, written.dy_um, self.gain, self.length_um, self.end_ratio)
