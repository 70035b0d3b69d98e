"""Whitening of correlated noise on maps with holes: conditional on a few neighbours (Vecchia 1988).

Pixels are taken in raster order. Given its measured predecessors n in a fixed neighbourhood, the noise at a point i has
mean b·ε_n with b = C_nn⁻¹ c_in and variance v = C_ii − c_in·b. The rows (ε_i − b·ε_n)/√v are nearly independent with
variance 1. They form a sparse matrix W with WᵀW ≈ C⁻¹ on the measured points alone: nothing is filled in, and no border
is wrapped round.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy import sparse

from dlwpredict.noise import Noise, matern

NEAR_PX, FAR_PX = 3, (5, 8, 13, 21)
"""Neighbours are all predecessors up to the first distance (rows and columns), and some at the further ones."""

_CHUNK = 4000


def covariance(noise: Noise, distance_um: np.ndarray) -> np.ndarray:
    """Return the noise's covariance at a distance, µm²."""
    correlated = noise.correlated_um**2 * matern(distance_um, noise.length_um, noise.smoothness)
    return correlated + np.where(distance_um == 0, noise.white_um**2, 0.0)


@dataclass(frozen=True, eq=False)
class Neighbourhood:
    """The measured predecessors of every measured point of a map.

    Parameters
    ----------
    used : numpy.ndarray of bool, shape (rows, cols)
        Measured points.
    dx_um, dy_um : float
        Pitch.
    near_px : int
    far_px : tuple of int
        Extent of the neighbourhood.
    """

    used: np.ndarray
    dx_um: float
    dy_um: float
    near_px: int = NEAR_PX
    far_px: tuple[int, ...] = FAR_PX
    index: np.ndarray = field(init=False, repr=False)
    present: np.ndarray = field(init=False, repr=False)
    lags_um: np.ndarray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        offsets = _offsets(self.near_px, self.far_px)
        reach = int(np.abs(offsets).max())
        number = np.full(np.add(self.used.shape, 2 * reach), -1)
        inner = number[reach:-reach, reach:-reach]
        inner[self.used] = np.arange(int(self.used.sum()))
        row, col = np.nonzero(self.used)
        index = np.stack([number[row + reach + r, col + reach + c] for r, c in offsets], axis=1)
        object.__setattr__(self, "index", index)
        object.__setattr__(self, "present", index >= 0)
        object.__setattr__(self, "lags_um", offsets * np.array([self.dy_um, self.dx_um]))

    def rows(self, noise: Noise, points: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Return coefficients b (points, neighbours) and variances v (points,) of the given points, or of all."""
        present = self.present if points is None else self.present[points]
        patterns, place = np.unique(np.packbits(present, axis=1), axis=0, return_inverse=True)
        patterns = np.unpackbits(patterns, axis=1, count=present.shape[1]).astype(float)
        lags = np.linalg.norm(self.lags_um[:, None] - self.lags_um, axis=-1)
        between, towards = covariance(noise, lags), covariance(noise, np.linalg.norm(self.lags_um, axis=-1))
        own = noise.sigma_um**2
        coefficients = np.empty(patterns.shape)
        for first in range(0, len(patterns), _CHUNK):
            known = patterns[first : first + _CHUNK]
            matrix = between * known[:, :, None] * known[:, None, :]
            matrix[:, range(known.shape[1]), range(known.shape[1])] += own * (1 - known)
            coefficients[first : first + _CHUNK] = np.linalg.solve(matrix, (towards * known)[..., None])[..., 0]
        variances = own - coefficients @ towards
        return coefficients[place.ravel()], variances[place.ravel()]

    def whitener(self, noise: Noise) -> sparse.csr_array:
        """Return W (points, points): W·ε has nearly independent entries of variance 1."""
        coefficients, variances = self.rows(noise)
        points = len(variances)
        scale = 1 / np.sqrt(variances)
        at, neighbour = np.nonzero(self.present)
        entries = np.concatenate([scale, -(coefficients * scale[:, None])[at, neighbour]])
        rows = np.concatenate([np.arange(points), at])
        cols = np.concatenate([np.arange(points), self.index[at, neighbour]])
        return sparse.csr_array((entries, (rows, cols)), shape=(points, points))


def _offsets(near_px: int, far_px: tuple[int, ...]) -> np.ndarray:
    """Return the neighbourhood as offsets (row, col) of predecessors in raster order, shape (neighbours, 2)."""
    near = range(-near_px, near_px + 1)
    chosen = [(r, c) for r in near for c in near]
    chosen += [(r, c) for d in far_px for r, c in ((0, -d), (-d, 0), (-d, -d), (-d, d), (-d // 2, -d), (-d // 2, d))]
    return np.array([(r, c) for r, c in chosen if r < 0 or (r == 0 and c < 0)])
