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

NEAR_PX, FAR_PX = 3, (5, 8, 13, 21)
"""Neighbours are all predecessors up to the first distance (rows and columns), and some at the further ones."""

_CHUNK = 4000


@dataclass(frozen=True)
class NoiseModel:
    """Covariance of the noise at lag d: nugget² [d = 0] + σ² (1 + √3 d/ℓ) exp(−√3 d/ℓ), Matérn with ν = 3/2.

    Parameters
    ----------
    nugget_um : float
        Standard deviation of the part that differs from pixel to pixel, µm.
    sigma_um : float
        Standard deviation of the correlated part, µm.
    length_um : float
        Length ℓ of the correlated part, µm; the correlation falls to 1/e at about 1.24 ℓ.

    Examples
    --------
    >>> model = NoiseModel(0.003, 0.004, 1.0)
    >>> round(model.total_um, 9)
    0.005
    """

    nugget_um: float
    sigma_um: float
    length_um: float

    @property
    def total_um(self) -> float:
        """Standard deviation of one pixel, µm."""
        return float(np.hypot(self.nugget_um, self.sigma_um))

    def covariance(self, distance_um: np.ndarray) -> np.ndarray:
        """Return the covariance at a distance, µm²."""
        scaled = np.sqrt(3) * np.asarray(distance_um) / self.length_um
        correlated = self.sigma_um**2 * (1 + scaled) * np.exp(-scaled)
        return correlated + np.where(np.asarray(distance_um) == 0, self.nugget_um**2, 0.0)

    def simulate(self, rng: np.random.Generator, shape: tuple[int, int], dx_um: float, dy_um: float) -> np.ndarray:
        """Draw one map of this noise, shape (rows, cols), µm, by circulant embedding on a frame wide against ℓ."""
        rows, cols = (int(n + np.ceil(8 * self.length_um / p)) for n, p in zip(shape, (dy_um, dx_um), strict=True))
        y = np.minimum(np.arange(rows), rows - np.arange(rows)) * dy_um
        x = np.minimum(np.arange(cols), cols - np.arange(cols)) * dx_um
        spectrum = np.fft.rfft2(self.covariance(np.hypot(y[:, None], x))).real
        white = np.fft.rfft2(rng.standard_normal((rows, cols)))
        noise = np.fft.irfft2(white * np.sqrt(np.maximum(spectrum, 0)), (rows, cols))
        return noise[: shape[0], : shape[1]]


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

    def rows(self, noise: NoiseModel, points: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Return coefficients b (points, neighbours) and variances v (points,) of the given points, or of all."""
        present = self.present if points is None else self.present[points]
        patterns, place = np.unique(np.packbits(present, axis=1), axis=0, return_inverse=True)
        patterns = np.unpackbits(patterns, axis=1, count=present.shape[1]).astype(float)
        lags = np.linalg.norm(self.lags_um[:, None] - self.lags_um, axis=-1)
        between, towards = noise.covariance(lags), noise.covariance(np.linalg.norm(self.lags_um, axis=-1))
        own = float(noise.covariance(np.zeros(1))[0])
        coefficients = np.empty(patterns.shape)
        for first in range(0, len(patterns), _CHUNK):
            known = patterns[first : first + _CHUNK]
            matrix = between * known[:, :, None] * known[:, None, :]
            matrix[:, range(known.shape[1]), range(known.shape[1])] += own * (1 - known)
            coefficients[first : first + _CHUNK] = np.linalg.solve(matrix, (towards * known)[..., None])[..., 0]
        variances = own - coefficients @ towards
        return coefficients[place.ravel()], variances[place.ravel()]

    def whitener(self, noise: NoiseModel) -> sparse.csr_array:
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
