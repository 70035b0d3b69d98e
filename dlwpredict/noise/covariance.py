"""Noise of a height map: white from pixel to pixel, plus a part with a correlation length.

Covariance over distance d: σ_n²·[d = 0] + σ_c²·M_ν(d/ℓ), a nugget and a Matérn covariance of smoothness ν: 1/2, 3/2,
5/2, or infinite (a Gaussian), whichever the map prefers. With ν fixed at 3/2, noise that an instrument has smoothed
would be taken for noise of three times its length. A recording that was read between its pixels has no white noise any
more: neighbours share some of theirs. Its nugget is a Gaussian of a fraction of a pixel, the grain, and what is rough
in its correlated part is smeared as much: M_ν(√(d² + c²)/ℓ), c = √(π/2) grains, over its value at 0 (positive definite
as M_ν is: a shift of d² keeps complete monotony; Schoenberg, Ann. Math. 39, 811, 1938).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import fft

SMOOTHNESSES = (0.5, 1.5, 2.5, np.inf)

PURE = 0.1
"""Share of a smeared nugget's variance that stays white, so that whitening stays well-conditioned."""

ROUNDED = float(np.sqrt(np.pi / 2))
"""Grains by which a correlation is rounded at distance 0: the mean distance of a Gaussian of that standard deviation in
the plane, and so what exp(−d/ℓ) is lowered by when it is smeared."""

FLOOR = 0.03
"""Least white share of the standard deviation: no map is smoother, and whitening stays well-conditioned."""

FORGOTTEN = 1e-4
"""Correlation below which draws may wrap round: far below what a map can tell, and it halves the area drawn."""


@dataclass(frozen=True)
class Noise:
    """A noise model on a grid.

    Parameters
    ----------
    white_um : float
        Standard deviation of the part without correlation, or with the grain's only, µm.
    correlated_um : float
        Standard deviation of the correlated part, µm.
    length_um : float
        Correlation length ℓ, µm.
    dx_um, dy_um : float
        Pitch, µm.
    smoothness : float
        ν: 0.5, 1.5, 2.5 or inf.
    grain_um : float
        Standard deviation of the Gaussian that the white part's covariance is, µm; 0: it is white.

    Examples
    --------
    >>> Noise(0.003, 0.004, 1.0, 0.5, 0.5).sigma_um
    0.005
    """

    white_um: float
    correlated_um: float
    length_um: float
    dx_um: float
    dy_um: float
    smoothness: float = 1.5
    grain_um: float = 0.0

    @property
    def sigma_um(self) -> float:
        """Standard deviation of one pixel, µm."""
        return float(np.hypot(self.white_um, self.correlated_um))

    @property
    def pitch_um(self) -> float:
        """Side of a square of a pixel's area, µm."""
        return float(np.sqrt(self.dx_um * self.dy_um))

    def at(self, distance_um: np.ndarray) -> np.ndarray:
        """Return the covariance at a distance, µm².

        Examples
        --------
        >>> Noise(2.0, 0.0, 1.0, 0.4, 0.4, grain_um=0.4).at(np.array([0.0, 0.4])).round(2).tolist()
        [4.0, 2.18]
        """
        same = distance_um == 0
        grain = PURE * same + (1 - PURE) * matern(distance_um, self.grain_um, np.inf) if self.grain_um else same
        round_um = ROUNDED * self.grain_um if np.isfinite(self.smoothness) else 0.0  # a Gaussian stays
        apart = matern(np.hypot(distance_um, round_um), self.length_um, self.smoothness)
        none = matern(np.array(round_um), self.length_um, self.smoothness)
        return self.correlated_um**2 * apart / none + self.white_um**2 * grain

    def covariance(self, shape: tuple[int, ...]) -> np.ndarray:
        """Return the covariance with pixel (0, 0) on a periodic grid, µm², shape ``shape``."""
        rows, cols = (np.minimum(np.arange(n), n - np.arange(n)) for n in shape)
        quarter = np.hypot(np.arange(rows.max() + 1)[:, None] * self.dy_um, np.arange(cols.max() + 1) * self.dx_um)
        return self.at(quarter)[np.ix_(rows, cols)]

    def times(self, maps: np.ndarray) -> np.ndarray:
        """Return covariance × map, exactly, shape (..., rows, cols); pixels that do not count must be 0."""
        shape = tuple(fft.next_fast_len(2 * n - 1, real=True) for n in maps.shape[-2:])
        transfer = fft.rfft2(self.covariance(shape)).real
        product = fft.irfft2(fft.rfft2(maps, shape) * transfer, shape)
        return product[..., : maps.shape[-2], : maps.shape[-1]]

    def simulate(self, shape: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
        """Draw one map of noise, shape (rows, cols)."""
        return self.simulate_many(shape, rng, 1)[0]

    def simulate_many(self, shape: tuple[int, int], rng: np.random.Generator, count: int) -> np.ndarray:
        """Draw maps of noise, shape (count, rows, cols), by circulant embedding.

        White noise times the root of the spectrum is transformed; the real and the imaginary part are two draws.

        Examples
        --------
        >>> Noise(1.0, 0.0, 1.0, 1.0, 1.0).simulate_many((3, 4), np.random.default_rng(0), 5).shape
        (5, 3, 4)
        """
        wide = self._period(shape)
        root = np.sqrt(np.maximum(fft.fft2(self.covariance(wide)).real, 0) / np.prod(wide)).astype(np.float32)
        drawn = np.empty((count, *shape))
        for first in range(0, count, 2):
            pair = root * rng.standard_normal((*wide, 2), dtype=np.float32).view(np.complex64)[..., 0]
            pair = fft.fft(fft.fft(pair, axis=0, overwrite_x=True)[: shape[0]], axis=1)[:, : shape[1]]
            drawn[first] = pair.real
            drawn[first + 1 : first + 2] = pair.imag
        return drawn

    def _period(self, shape: tuple[int, int]) -> tuple[int, ...]:
        """Return the period of a periodic grid on which points of the map do not meet their neighbours' images."""
        pitches = (self.dy_um, self.dx_um)
        reach_um = np.arange(1, 2 * max(shape)) * min(pitches)
        close = self.at(reach_um) > FORGOTTEN * self.sigma_um**2
        furthest = reach_um[close][-1] if close.any() else 0.0
        margins = [min(n, int(furthest / pitch) + 1) for n, pitch in zip(shape, pitches, strict=True)]
        return tuple(fft.next_fast_len(n + margin) for n, margin in zip(shape, margins, strict=True))

    def effective_points(self, used: np.ndarray) -> float:
        """Return how many independent points would know the mean as well as the used ones: n²σ²/ΣΣ C."""
        counted = used.astype(float)
        return float(counted.sum() ** 2 * self.sigma_um**2 / np.sum(counted * self.times(counted)))


def matern(distance: np.ndarray, length: float, smoothness: float = 1.5) -> np.ndarray:
    """Return the Matérn correlation M_ν(d/ℓ) (Rasmussen & Williams, Gaussian Processes, 2006, ch. 4).

    Examples
    --------
    >>> [round(float(matern(1.0, 1.0, nu)), 3) for nu in SMOOTHNESSES]
    [0.368, 0.483, 0.524, 0.607]
    """
    if smoothness == np.inf:
        return np.exp(-((distance / length) ** 2) / 2)
    scaled = np.sqrt(2 * smoothness) * distance / length
    return {0.5: 1.0, 1.5: 1 + scaled, 2.5: 1 + scaled + scaled**2 / 3}[smoothness] * np.exp(-scaled)
