"""Line-end pile-up: the beam is slower where a line starts and stops, and the dose is higher there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dlwpredict.effects.base import DoseEffect
from dlwpredict.effects.plane import occupied
from dlwpredict.heightmap import HeightMap
from dlwpredict.parameters import declare


def distance_to_end(on: np.ndarray, pitch: float) -> np.ndarray:
    """Return the distance of every pixel's centre to the top (row 0 side) end of its run of ones along the rows.

    Parameters
    ----------
    on : numpy.ndarray of bool, shape (rows, cols)
    pitch : float
        Distance of the rows, µm.

    Examples
    --------
    >>> distance_to_end(np.array([[0, 1, 1, 0, 1]], dtype=bool).T, 1.0).T[0, [1, 2, 4]].tolist()
    [0.5, 1.5, 0.5]
    """
    row = np.arange(len(on))[:, None]
    last_off = np.maximum.accumulate(np.where(on, -1, row), axis=0)
    return (row - last_off - 0.5) * pitch


def line_end_intensity(on: np.ndarray, dy_um: float, gain: float, length_um: float, end_ratio: float) -> np.ndarray:
    """Return D = 1 + gain · (e^(−d₋/L) + end_ratio · e^(−d₊/L)) on the written segments, 1 elsewhere.

    d₋ and d₊ are the distances to the start (low y) and the end (high y) of the segment, inner gaps counting as
    ends. At constant acceleration and power the dose per length is largest where the beam is slowest.

    Parameters
    ----------
    on : numpy.ndarray of bool, shape (rows, cols)
        Where this layer is written; row 0 is the highest y.
    dy_um, length_um : float
        Pitch, and decay length L, µm.
    gain, end_ratio : float
    """
    to_start = distance_to_end(on[::-1], dy_um)[::-1]
    to_end = distance_to_end(on, dy_um)
    half = dy_um / (2 * length_um)
    pixel_mean = np.sinh(half) / half
    ends = np.exp(-to_start / length_um) + end_ratio * np.exp(-to_end / length_um)
    return 1 + gain * pixel_mean * np.where(on, ends, 0)


@dataclass(frozen=True)
class LineEndPileup(DoseEffect):
    """More dose at the start and end of every written segment, in every layer."""

    name = "line-end-pileup"
    meaning = "too much dose where the lines start and stop: ridges on the edges that face along y"
    frame = "printer"
    source = "Lang 2022 (constant acceleration); gardner-lab/printimage (compensates beam speed)"
    confused_with = ("edge-drying", "batwings", "dose-memory")
    separated_by = "edges along x against edges along y on one part of two heights, or a series of scan speeds"
    isotropic = False

    gain: float = declare(0.0, "1", 0.0, 1.0, "additional intensity at the start of a line", typical=0.15)
    length_um: float = declare(2.0, "µm", 0.2, 20, "distance over which it decays")
    end_ratio: float = declare(1.0, "1", 0.0, 1.0, "gain at the end of a line over that at its start")

    def intensity(self, written: HeightMap, z_um: float) -> np.ndarray:
        """Return D of the segments written at height z."""
        on = occupied(written, z_um) > 0
        return line_end_intensity(on, written.dy_um, self.gain, self.length_um, self.end_ratio)
