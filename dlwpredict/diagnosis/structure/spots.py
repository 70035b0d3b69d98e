"""Spots: bumps and dents in one place, as particles, bubbles and scratches leave them, narrower than any free form."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from typing import ClassVar

import numpy as np
from scipy import ndimage, special

from dlwpredict.diagnosis.structure.largest import LARGEST_OF, p_of_largest
from dlwpredict.infer.objective import Fit
from dlwpredict.infer.whitened import Whitened
from dlwpredict.numerics.smoothing import FWHM_PER_SIGMA

SCALES_PX = (1.0, 2.5, 6.0)
"""Standard deviations of the bumps that are looked for, pixels."""

SURE, BRIDGED_PX = 0.95, 3
"""A pixel belongs to a spot where the mismatch is at least this sure, gaps of less than twice so many pixels too."""

SPREAD_DRAWS = 40
"""Maps of white noise from which the spread of a score is known."""


@dataclass(frozen=True)
class Spot:
    """The bump or dent that stands out most.

    Parameters
    ----------
    pair : int
    x_um, y_um : float
        Where it is, from the map's centre, y upwards.
    fwhm_um : float
        About how wide.
    excess : float
        Energy in units of the noise, above its average.
    p_value : float
        Probability that noise alone has one as strong anywhere.
    """

    kind: ClassVar[str] = "spot"

    pair: int
    x_um: float
    y_um: float
    fwhm_um: float
    excess: float
    p_value: float


@dataclass(frozen=True, eq=False)
class Bumps:
    """The best test for a bump g in noise of covariance C, at every pixel at once: gᵀC⁻¹r/√(gᵀC⁻¹g), with C⁻¹ = WᵀW.

    Parameters
    ----------
    item : Whitened
    spread : numpy.ndarray, shape (scales, rows, cols)
        Standard deviation of the numerator under noise alone: from draws, the mean over points near by.
    """

    item: Whitened
    spread: np.ndarray

    @classmethod
    def of(cls, item: Whitened, seed: int = 0) -> Bumps:
        """Learn the spread from drawn noise."""
        rng = np.random.default_rng(seed)
        draws = (rng.standard_normal(item.recording.points) for _ in range(SPREAD_DRAWS))
        variance = reduce(np.add, (_matched(item, white) ** 2 for white in draws)) / SPREAD_DRAWS
        used = item.recording.used
        smooth = [_near(one, used, 2 * scale) for one, scale in zip(variance, SCALES_PX, strict=True)]
        return cls(item, np.sqrt(np.maximum(smooth, 1e-30)))

    def scores(self, white: np.ndarray) -> np.ndarray:
        """Score bumps of all sizes at every pixel, shape (scales, rows, cols), in standard deviations."""
        return np.where(self.item.recording.used, _matched(self.item, white) / self.spread, 0.0)


def _near(values: np.ndarray, used: np.ndarray, sigma_px: float) -> np.ndarray:
    """Return the mean over the points near by that count: what lies beyond them would pull it down."""
    weighed, counted = (ndimage.gaussian_filter(one, sigma_px, mode="constant") for one in (values * used, used * 1.0))
    mean: np.ndarray = weighed / np.maximum(counted, 1e-12)
    return mean


def _matched(item: Whitened, white: np.ndarray) -> np.ndarray:
    plane = np.zeros(item.recording.used.shape)
    plane[item.recording.used] = item.whitener.transposed(white)
    return np.stack([ndimage.gaussian_filter(plane, s, mode="constant") for s in SCALES_PX])


def spot(fitted: Fit, draws: np.ndarray, bumps: Sequence[Bumps]) -> Spot:
    """Test the largest score of a bump anywhere on any recording against the largest ones of the null's draws.

    Parameters
    ----------
    fitted : Fit
    draws : numpy.ndarray, shape (rows, draws)
        From `Null.beside` this fit.
    bumps : sequence of Bumps
        Of every recording.
    """
    spots = []
    for k, item in enumerate(fitted.data):
        rows, grid = fitted.rows.of(k), item.recording.target
        power = bumps[k].scores(fitted.residual[rows]) ** 2
        largest = np.array([np.max(bumps[k].scores(draw) ** 2) for draw in draws[rows, :LARGEST_OF].T])
        scale, row, col = np.unravel_index(np.argmax(power), power.shape)
        energy = float(power[scale, row, col])
        fwhm_um = FWHM_PER_SIGMA * SCALES_PX[scale] * float(np.sqrt(grid.dx_um * grid.dy_um))
        place = float(grid.x_um[col]), float(grid.y_um[row])
        spots.append(Spot(k, *place, fwhm_um, energy - 1, p_of_largest(energy, largest, of=len(fitted.data))))
    return min(spots, key=lambda bump: bump.p_value)


def mismatch(score: np.ndarray, used: np.ndarray) -> np.ndarray:
    """Return how surely each pixel differs beyond noise, 0 to 1, shape (rows, cols).

    1 − p, with p corrected for the number of bumps that fit on the map side by side, at all sizes.
    """
    single = 2 * special.ndtr(-np.abs(score))
    bumps = np.array([max(used.sum() / (4 * np.pi * s**2), 1.0) for s in SCALES_PX[: len(score)]])[:, None, None]
    return np.where(used, 1 - np.minimum(single * bumps * len(score), 1).min(axis=0), 0.0)


def patch(sure: np.ndarray, row: int, col: int) -> np.ndarray:
    """Return the connected region of sure mismatch about a pixel, (rows, cols) of bool; a small square without one."""
    region = np.pad(sure >= SURE, BRIDGED_PX + 1)
    region |= ndimage.binary_closing(region, iterations=BRIDGED_PX)
    labels, _ = ndimage.label(region, structure=np.ones((3, 3)))
    inner = (slice(BRIDGED_PX + 1, -BRIDGED_PX - 1),) * 2
    labels = labels[inner]
    if labels[row, col]:
        return labels == labels[row, col]
    square = np.zeros(sure.shape, dtype=bool)
    square[max(row - BRIDGED_PX, 0) : row + BRIDGED_PX + 1, max(col - BRIDGED_PX, 0) : col + BRIDGED_PX + 1] = True
    return square
