"""What a printer can be asked for: a correction without spikes, not too steep, with no feature too fine.

All of it acts on the correction, what is to be written less the target: the design's own steps and walls stay.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy import ndimage

from dlwpredict.errors import InputError
from dlwpredict.heightmap import HeightMap
from dlwpredict.numerics.smoothing import FWHM_PER_SIGMA

NEIGHBOURS = [step for step in product((-1, 0, 1), repeat=2) if step != (0, 0)]


@dataclass(frozen=True)
class Printable:
    """Bounds on the shape of a correction.

    Parameters
    ----------
    smooth_um : float
        FWHM of the Gaussian that the correction is smoothed by, µm; 0 = not at all.
    steepest : float
        Largest slope of what is written, µm/µm, where the target is no steeper itself.
    smallest_um : float
        Width below which hills and pits of the correction are taken away, µm; 0 = none.

    Raises
    ------
    InputError
        A negative length, or a slope that is not above 0.
    """

    smooth_um: float = 0.0
    steepest: float = np.inf
    smallest_um: float = 0.0

    def __post_init__(self) -> None:
        for value, key in ((self.smooth_um, "--smooth-um"), (self.smallest_um, "--smallest-feature-um")):
            if not 0 <= value < np.inf:
                raise InputError(f"found {value:g}", key=key, allowed="allowed: 0 or more")
        if not self.steepest > 0:
            raise InputError(f"found {self.steepest:g}", key="--max-slope", allowed="allowed: above 0")

    def require_within(self, widest_um: float) -> None:
        """Refuse a width that is larger than the map.

        Raises
        ------
        InputError
        """
        for width, key in ((self.smooth_um, "--smooth-um"), (self.smallest_um, "--smallest-feature-um")):
            if width > widest_um:
                raise InputError(f"found {width:g} µm", key=key, allowed=f"allowed: to {widest_um:g} µm for this map")

    def of(self, written: np.ndarray, target: HeightMap) -> np.ndarray:
        """Return heights (rows, cols) near these whose correction can be printed; beside the part they stay.

        Examples
        --------
        >>> part = HeightMap(np.ones((9, 9)), 0.1, 0.1)
        >>> comb = 1 + 0.5 * (np.arange(9) % 2) + np.zeros((9, 1))
        >>> float(np.ptp(Printable(smallest_um=0.3).of(comb, part)))
        0.0
        """
        footprint, h = target.heights_um > 0, target.heights_um
        change = np.where(footprint, written - h, 0.0)
        if self.smallest_um:
            change = _without_small(change, footprint, target, self.smallest_um)
        if self.smooth_um:
            change = _smoothed(change, footprint, target, self.smooth_um)
        heights = np.where(footprint, h + change, written)
        return heights if self.steepest == np.inf else _no_steeper(heights, footprint, target, self.steepest)


def _smoothed(change: np.ndarray, footprint: np.ndarray, grid: HeightMap, fwhm_um: float) -> np.ndarray:
    """Return the mean under a Gaussian of what lies on the part."""
    sigmas = [fwhm_um / FWHM_PER_SIGMA / pitch for pitch in (grid.dy_um, grid.dx_um)]
    above, below = (
        ndimage.gaussian_filter(values, sigmas, mode="nearest") for values in (change, footprint.astype(float))
    )
    return np.where(footprint, above / np.maximum(below, 1e-12), 0.0)


def _without_small(change: np.ndarray, footprint: np.ndarray, grid: HeightMap, width_um: float) -> np.ndarray:
    """Return the mean of opening after closing and closing after opening by a disc; beside the part lies nothing."""
    radii = [width_um / 2 / pitch for pitch in (grid.dy_um, grid.dx_um)]
    rows, cols = (np.arange(-int(r), int(r) + 1) / max(r, 1e-9) for r in radii)
    disc = np.hypot(*np.meshgrid(rows, cols, indexing="ij")) <= 1

    def lowest(values: np.ndarray) -> np.ndarray:
        return ndimage.grey_erosion(np.where(footprint, values, np.inf), footprint=disc, mode="nearest")

    def highest(values: np.ndarray) -> np.ndarray:
        return ndimage.grey_dilation(np.where(footprint, values, -np.inf), footprint=disc, mode="nearest")

    closing, opening = lowest(highest(highest(lowest(change)))), highest(lowest(lowest(highest(change))))
    return (np.where(footprint, closing, 0.0) + np.where(footprint, opening, 0.0)) / 2


def _no_steeper(heights: np.ndarray, footprint: np.ndarray, target: HeightMap, steepest: float) -> np.ndarray:
    """Return the highest surface below that rises from no pixel to the next by more than a slope, or than the target.

    Neighbours are relaxed until none is too high, as distances on a grid are (Borgefors, 1986).
    """
    h, surface = target.heights_um, heights
    while True:
        before = surface
        for r, c in NEIGHBOURS:
            run = steepest * float(np.hypot(r * target.dy_um, c * target.dx_um))
            beside = _moved(np.where(footprint, surface + run, np.inf), r, c)
            rise = np.maximum(h - _moved(h, r, c) - run, 0.0)
            surface = np.where(footprint, np.minimum(surface, beside + rise), surface)
        if np.array_equal(surface, before):
            return surface


def _moved(values: np.ndarray, rows: int, cols: int) -> np.ndarray:
    """Return what stands so many pixels away; beyond the map what stands at its rim."""
    padded = np.pad(values, 1, mode="edge")
    return padded[1 + rows : 1 + rows + values.shape[0], 1 + cols : 1 + cols + values.shape[1]]
