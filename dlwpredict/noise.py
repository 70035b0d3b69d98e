"""Noise of a height map: white from pixel to pixel, plus a part with a correlation length; with masks treated exactly.

Covariance over distance d: σ_n²·[d = 0] + σ_c²·M_ν(d/ℓ), a nugget and a Matérn covariance of smoothness ν: 1/2, 3/2,
5/2, or infinite (a Gaussian), whichever the map prefers. With ν fixed at 3/2, noise that an instrument has smoothed
would be taken for noise of three times its length. A recording that was read between its pixels has no white noise any
more: neighbours share some of theirs. Its nugget is a Gaussian of a fraction of a pixel, the grain.

Pixels that do not count are never filled with zeros and then filtered: products with the covariance are restricted to
the pixels that count, and its inverse is solved for on these alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy  # scipy.signal takes longer to load than all else: on first use
from scipy import fft
from scipy.sparse.linalg import LinearOperator, cg

from dlwpredict.errors import ResultError

SMOOTHNESSES = (0.5, 1.5, 2.5, np.inf)

PURE = 0.1
"""Share of a smeared nugget's variance that stays white, so that whitening stays well-conditioned."""

FLOOR = 0.03
"""Least white share of the standard deviation: no map is smoother, and whitening stays well-conditioned."""

LARGEST_PX = 256
"""Maps are analysed in tiles of at most this many pixels a side."""

TAPER = 0.2
"""Share of each side over which a tile fades out before its spectrum is taken."""

MOST_STEPS, ENOUGH = 40, 1e-2
"""Scoring ends after so many steps, or where −2 ln L falls by less than this."""

OUTLIER = 5.0
"""Residuals are clipped at this many robust standard deviations, so that spikes do not pass for noise."""


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
    noise_from : str
        How it was estimated.
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
    noise_from: str = "given"
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
        return self.correlated_um**2 * matern(distance_um, self.length_um, self.smoothness) + self.white_um**2 * grain

    def covariance(self, shape: tuple[int, int]) -> np.ndarray:
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

    def solve(self, values: np.ndarray, used: np.ndarray, *, tolerance: float = 1e-6) -> np.ndarray:
        """Return covariance⁻¹ × values over the pixels that count, by preconditioned conjugate gradients.

        Parameters
        ----------
        values : numpy.ndarray, shape (..., points)
            Values at the used pixels.
        used : numpy.ndarray of bool, shape (rows, cols)

        Raises
        ------
        ResultError
            No convergence.
        """
        transfer = np.maximum(fft.rfft2(self.covariance(used.shape)).real, 1e-6 * self.sigma_um**2)

        def times(vector: np.ndarray) -> np.ndarray:
            return self.times(scatter(vector, used))[used]

        def nearly_inverse(vector: np.ndarray) -> np.ndarray:
            return fft.irfft2(fft.rfft2(scatter(vector, used)) / transfer, used.shape)[used]

        size = (int(used.sum()),) * 2
        operator, close = LinearOperator(size, times, dtype=float), LinearOperator(size, nearly_inverse, dtype=float)
        solved = np.empty_like(values, dtype=float)
        for place in np.ndindex(values.shape[:-1]):
            solved[place], failed = cg(operator, values[place], rtol=tolerance, maxiter=500, M=close)
            if failed:
                raise ResultError(f"whitening did not converge ({self})", key="noise")
        return solved

    def conditional_mean(self, values: np.ndarray, used: np.ndarray) -> np.ndarray:
        """Return the map with its gaps filled by what the noise model expects there, shape (rows, cols)."""
        filled = self.times(scatter(self.solve(values, used), used))
        filled[used] = values
        return filled

    def simulate(self, shape: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
        """Draw one map of noise, shape (rows, cols), by circulant embedding on twice the size."""
        wide = tuple(fft.next_fast_len(2 * n, real=True) for n in shape)
        root = np.sqrt(np.maximum(fft.rfft2(self.covariance(wide)).real, 0))
        return fft.irfft2(fft.rfft2(rng.standard_normal(wide)) * root, wide)[: shape[0], : shape[1]]

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


def scatter(values: np.ndarray, used: np.ndarray) -> np.ndarray:
    """Return values at the used pixels as a map, 0 elsewhere, shape (..., rows, cols)."""
    maps = np.zeros((*values.shape[:-1], *used.shape))
    maps[..., used] = values
    return maps


def estimate(
    maps: Sequence[np.ndarray],
    used: np.ndarray,
    dx_um: float,
    dy_um: float,
    *,
    smoothness: float | None = None,
    noise_from: str = "residual",
) -> Noise:
    """Estimate the noise by the debiased Whittle likelihood (Guillaumin et al., J. R. Stat. Soc. B 84, 1526, 2022).

    The periodogram of the masked, tapered map is compared with its expectation under the model, the transform of
    covariance × autocorrelation of the mask: gaps, edges and short maps are part of the model, nothing is filled.
    Every octave of wavelength has the same weight. Unweighted, the many short waves decide alone, and on real residuals
    the long ones, which move parameters, come out too weak (effective points 80 times too many on an AFM map).
    What the model of the print cannot explain counts as noise, so a wrong model makes the noise larger and longer.

    Parameters
    ----------
    maps : sequence of numpy.ndarray, shape (rows, cols)
        Residuals (or differences of repeats, divided by √2), all of one noise, µm.
    used : numpy.ndarray of bool, shape (rows, cols)
        Pixels that count.
    dx_um, dy_um : float
        Pitch, µm.
    smoothness : float, optional
        ν, if it is known.
    noise_from : str
        Where the maps come from, for the record.
    """
    bulk = np.concatenate([values[used] for values in maps])
    cut = OUTLIER * max(1.4826 * float(np.median(np.abs(bulk))), 1e-6)
    clipped = [np.where(used, np.clip(values, -cut, cut), 0.0) for values in maps]
    tiles = [_Tile.of([values[at] for values in clipped], used[at]) for at in _tiles(used)]
    side = min(n * p for n, p in zip(used.shape, (dy_um, dx_um), strict=True))
    spread = float(np.std(np.clip(bulk, -cut, cut)))
    lengths = 0.7 * min(dx_um, dy_um), max(side / 4, 2 * max(dx_um, dy_um))
    kinds = SMOOTHNESSES if smoothness is None else (smoothness,)
    least = [Noise(FLOOR * spread, spread, lengths[0], dx_um, dy_um, nu, noise_from) for nu in kinds]
    starts = [np.log([0.2 * spread, 0.9 * spread, length]) for length in np.geomspace(*lengths, 5)]
    found = [_fit(tiles, noise, lengths, starts) for noise in least]
    return min(found, key=lambda fit: fit[1])[0]


def _fit(
    tiles: Sequence[_Tile], least: Noise, lengths: tuple[float, float], starts: Sequence[np.ndarray]
) -> tuple[Noise, float]:
    """Return the most likely noise of one smoothness, and its misfit, by damped Fisher scoring on the logarithms."""
    low = np.log([least.white_um, 1e-3 * least.correlated_um, lengths[0]])
    high = np.log([3 * least.correlated_um, 3 * least.correlated_um, lengths[1]])

    def model(logs: np.ndarray) -> Noise:
        white, correlated, length = np.exp(logs)
        return replace(least, white_um=float(white), correlated_um=float(correlated), length_um=float(length))

    def misfit(logs: np.ndarray) -> float:
        return sum(tile.misfit(model(logs)) for tile in tiles)

    logs = min((np.clip(start, low, high) for start in starts), key=misfit)
    lowest, damping = misfit(logs), 1e-3
    information, score = _scoring(tiles, model(logs))
    for _ in range(MOST_STEPS):
        step = np.linalg.solve(information + damping * np.diag(np.diag(information) + 1e-6), score[0])
        trial = np.clip(logs + np.clip(step, -1, 1), low, high)
        cost = misfit(trial)
        if cost > lowest:
            damping = max(10 * damping, 1e-2)
            continue
        gained, logs, lowest, damping = lowest - cost, trial, cost, damping / 10
        if gained < ENOUGH:
            break
        information, score = _scoring(tiles, model(logs))
    return model(logs), lowest


def _scoring(tiles: Sequence[_Tile], noise: Noise) -> tuple[np.ndarray, np.ndarray]:
    """Return Fisher's information (3, 3) about the logarithms, and the score of every map (maps, 3)."""
    information, score = np.zeros((3, 3)), 0.0
    for tile in tiles:
        power = tile.expected(noise)
        slopes = np.stack([(tile.expected(nearby) / power - 1) / 0.02 for nearby in scaled_each(noise, 1.02)])
        information += np.einsum("irc,jrc->ij", slopes * tile.weights, slopes)
        score = score + np.einsum("irc,krc->ki", slopes * tile.weights, tile.spectra / power - 1)
    return information, score


def estimation_errors(noise: Noise, maps: Sequence[np.ndarray], used: np.ndarray) -> np.ndarray:
    """Return how estimates from these maps would differ from the model they were drawn from, to first order.

    One step of Fisher scoring from the model, so that many draws cost one spectrum each and no search. Directions that
    the spectrum does not know are held by a prior of one e-fold.

    Returns
    -------
    numpy.ndarray, shape (maps, 3)
        Differences in the logarithms of (white, correlated, length), at most one e-fold.
    """
    tiles = [_Tile.of([np.where(used, values, 0.0)[at] for values in maps], used[at], keep=True) for at in _tiles(used)]
    information, score = _scoring(tiles, noise)
    return np.clip(np.linalg.solve(information + np.eye(3), score.T).T, -1, 1)


def scaled_each(noise: Noise, factor: float) -> list[Noise]:
    """Return the noise with white, correlated and length multiplied by a factor, one at a time."""
    return [
        replace(noise, **{name: getattr(noise, name) * factor}) for name in ("white_um", "correlated_um", "length_um")
    ]


def _tiles(used: np.ndarray) -> list[tuple[slice, slice]]:
    """Return the at most four tiles with most used pixels, each no larger than `LARGEST_PX` a side."""
    cuts = [np.linspace(0, n, -(-n // LARGEST_PX) + 1).astype(int) for n in used.shape]
    places = [(slice(a, b), slice(c, d)) for a, b in zip(cuts[0], cuts[0][1:], strict=False)
              for c, d in zip(cuts[1], cuts[1][1:], strict=False)]  # fmt: skip
    return sorted(places, key=lambda at: -used[at].sum())[:4]


@dataclass(frozen=True, eq=False)
class _Tile:
    """One tile: spectra of the tapered maps (one half-plane; maps are real), and the autocorrelation of the taper."""

    spectra: np.ndarray
    weights: np.ndarray
    taper_correlation: np.ndarray
    maps: int

    @classmethod
    def of(cls, maps: list[np.ndarray], used: np.ndarray, *, keep: bool = False) -> _Tile:
        """Return the tile with the spectrum of each map, or only their mean."""
        taper = np.outer(*(scipy.signal.windows.tukey(n + 2, TAPER)[1:-1] for n in used.shape)) * used
        wide = tuple(2 * n for n in used.shape)
        correlation = fft.irfft2(np.abs(fft.rfft2(taper, wide)) ** 2, wide)
        spectra = np.stack([np.abs(fft.rfft2(values * taper)) ** 2 for values in maps])
        weights = _octave_weights(used.shape)
        return cls(spectra if keep else spectra.mean(axis=0, keepdims=True), weights, correlation, len(maps))

    def expected(self, noise: Noise) -> np.ndarray:
        """Return the spectrum that the model expects of a tapered map."""
        rows, cols = (n // 2 for n in self.taper_correlation.shape)
        product = noise.covariance(self.taper_correlation.shape) * self.taper_correlation
        folded = product.reshape(2, rows, 2, cols).sum(axis=(0, 2))  # lags l and l − n share a frequency grid
        return np.maximum(fft.rfft2(folded).real, 1e-30)

    def misfit(self, noise: Noise) -> float:
        """Return −2 ln of the Whittle likelihood up to a constant."""
        power = self.expected(noise)
        return self.maps * float(np.sum(self.weights * (np.log(power) + self.spectra[0] / power)))


def _octave_weights(shape: tuple[int, int]) -> np.ndarray:
    """Return weights 1/f² of mean 1 over the half-plane; flat below two waves per side."""
    frequency = np.hypot(fft.fftfreq(shape[0])[:, None], fft.rfftfreq(shape[1]))
    weights = np.maximum(frequency, 2 / max(shape)) ** -2.0
    return weights / weights.mean()
