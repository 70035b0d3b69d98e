"""Noise of whole lines of a scan: every line that an instrument scans has an offset and a tilt of its own.

From line to line the offsets are independent (white), drift (red), and swing with the mains or with a fan (hum). All of
it is part of the covariance: flattening line by line would take the same share out of what the surface has along them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy import linalg, optimize, sparse, special

OFFSET, TILT = 0, 1
"""What is constant along a line, and what is odd: powers of the place on it."""

LEVEL = 0.01
"""Probability that even noise is called uneven, each way of being so."""

RED_LINES = 1.0, 8.0
"""Lines after which a drift is forgotten by 1/e, that are looked for. What drifts more slowly is not told from relief:
of a real print, misfit passed for a drift of 26 nm over 60 lines, which then explained it away."""

HUM_PERIODS = 2.0, 40.0
"""Periods of a hum, in lines, that are looked for."""

HUM_LINES = 3.0, 300.0
"""Lines after which a hum has lost its phase by 1/e, that are looked for."""

HALF = 0.5
"""Distance, in lines, of the offsets of lines that lean: a swing of two or three lines is read to a tenth then."""

SMALLEST = 1e-4
"""Part of the variance of the offsets below which a part is none."""

STEP, FLAT = 1e-4, 1e-6
"""Change of the logarithm of a parameter by which covariances are differentiated; and the share of the gain, less than
which one more step of the descent would bring."""


@dataclass(frozen=True)
class Lines:
    """Offsets and tilts of lines, stationary from line to line.

    cov(d) = w²·[d = 0] + r²·exp(−d/ℓ) + h²·exp(−d/ℓ_h)·cos(2πd/T) of offsets d lines apart (w white; r, ℓ drift, an
    autoregressive process of first order; h, ℓ_h, T hum, a swing that is kicked at random); tilts are independent.

    Parameters
    ----------
    white_um, red_um, hum_um : float
        Standard deviations of the parts of the offsets, µm.
    red_lines, hum_lines : float
        ℓ and ℓ_h, lines.
    period_lines : float
        T, lines.
    tilt_um : float
        Standard deviation of the tilts: of the height at either end of a line, µm.
    lean : float
        Lines that the map's row (or column) crosses per pixel, where the scan is turned against the map. Offsets are
        then known at every half line, for points lie anywhere between two lines.

    Examples
    --------
    >>> Lines(white_um=3.0, red_um=4.0).offset_um
    5.0
    >>> Lines(red_um=1.0, red_lines=2.0).covariance(3)[0].round(3).tolist()
    [1.0, 0.607, 0.368]
    """

    white_um: float = 0.0
    red_um: float = 0.0
    red_lines: float = 1.0
    hum_um: float = 0.0
    hum_lines: float = 1.0
    period_lines: float = 4.0
    tilt_um: float = 0.0
    lean: float = 0.0

    @property
    def spacing(self) -> float:
        """Distance of the offsets, lines."""
        return HALF if self.lean else 1.0

    @property
    def offset_um(self) -> float:
        """Standard deviation of an offset, µm."""
        return float(np.sqrt(self.white_um**2 + self.red_um**2 + self.hum_um**2))

    def covariance(self, count: int) -> np.ndarray:
        """Return the covariance of successive offsets, µm², shape (count, count)."""
        return linalg.toeplitz(self._of_offsets(np.arange(count)))

    def between(self, lag: np.ndarray) -> np.ndarray:
        """Return the covariance of points that lie so many lines apart, µm², shape (lags,).

        A point between two offsets of lines that lean has its share of either: averaged over all places,
        Σ_k C_k·B(τ − k) at τ offsets apart, with the cubic B-spline B, the autocorrelation of linear interpolation.
        """
        apart = np.abs(lag) / self.spacing
        if not self.lean:
            return self._of_offsets(apart)
        offsets = np.floor(apart)[:, None] + np.arange(-1, 3)
        distance = np.abs(apart[:, None] - offsets)
        near, far = 2 / 3 - distance**2 + distance**3 / 2, np.maximum(2 - distance, 0) ** 3 / 6
        return np.sum(self._of_offsets(np.abs(offsets)) * np.where(distance < 1, near, far), axis=1)

    def _of_offsets(self, steps: np.ndarray) -> np.ndarray:
        """Return C, the covariance of offsets so many steps from one to the next apart, µm²."""
        lag = self.spacing * steps
        swing = np.exp(-lag / self.hum_lines) * np.cos(2 * np.pi * lag / self.period_lines)
        drift = self.red_um**2 * np.exp(-lag / self.red_lines)
        return drift + self.hum_um**2 * swing + self.white_um**2 * (steps == 0)

    def root(self, count: int) -> np.ndarray:
        """Return L with L·Lᵀ the covariance of the offsets, µm, shape (count, count)."""
        return _root(self, count)

    def simulate(self, rows: int, cols: int, rng: np.random.Generator, draws: int) -> np.ndarray:
        """Draw offsets and tilts of lines that are rows, or lean against them, µm, shape (draws, rows, cols)."""
        whole = np.ones((rows, cols), dtype=bool)
        offset = on_lines(whole, 0, OFFSET, self.lean)
        count = offset.shape[1]
        drawn = offset @ (self.root(count) @ rng.standard_normal((count, draws)))
        if self.tilt_um:
            drawn += on_lines(whole, 0, TILT, self.lean) @ (self.tilt_um * rng.standard_normal((count, draws)))
        return drawn.T.reshape(draws, rows, cols)


@lru_cache(maxsize=4)
def _root(lines: Lines, count: int) -> np.ndarray:
    """Return `Lines.root`, remembered: a recording's noise is drawn and whitened many times by one model of lines."""
    matrix = lines.covariance(count)
    root = np.linalg.cholesky(matrix + 1e-9 * max(matrix[0, 0], 1e-300) * np.eye(count))
    root.setflags(write=False)
    return root


def on_lines(used: np.ndarray, axis: int, order: int = OFFSET, lean: float = 0.0) -> sparse.csr_array:
    """Return what each line of a scan has at the measured points of a map, shape (points, lines).

    1 for an offset; the place along the line, from −1 to 1 over the map, for a tilt. Where lines lean against the rows
    (axis 0) or columns (axis 1), a point between two offsets, half a line apart, has its share of either.

    Examples
    --------
    >>> on_lines(np.ones((2, 3), dtype=bool), 0, lean=0.4).toarray()[:3].round(2).tolist()
    [[0.0, 0.8, 0.2, 0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.2, 0.8, 0.0, 0.0, 0.0]]
    """
    line, place = np.nonzero(used)[axis], np.nonzero(used)[1 - axis]
    half = (used.shape[1 - axis] - 1) / 2
    beyond = int(np.ceil(abs(lean) * half))
    values, point = np.linspace(-1, 1, used.shape[1 - axis])[place] ** order, np.arange(len(line))
    if not lean:
        return sparse.csr_array((values, (point, line)), shape=(len(line), used.shape[axis]))
    across = (line + beyond + lean * (place - half)) / HALF
    count = round((used.shape[axis] - 1 + 2 * beyond) / HALF) + 1
    below = np.floor(across).astype(int)
    share = across - below
    entries = np.append(values * (1 - share), values * share)
    places = np.append(point, point), np.minimum(np.append(below, below + 1), count - 1)
    return sparse.csr_array((entries, places), shape=(len(line), count))


def likeliest(energies: np.ndarray, along: np.ndarray, white_um: float, lean: float = 0.0) -> Lines:
    """Return the most likely process of offsets that are known to be there: drift and hum where more than chance.

    With G = AᵀA and c = Aᵀw of whitened values w and lines A, both beside all else, and K the covariance:
    2 ln L(K) − 2 ln L(0) = cᵀ·(K⁻¹ + G)⁻¹·c − ln det(I + K·G).

    Parameters
    ----------
    energies : numpy.ndarray, shape (lines, lines)
        G, 1/µm².
    along : numpy.ndarray, shape (lines,)
        c, 1/µm.
    white_um : float
        The most likely standard deviation of independent offsets.
    lean : float
        Of the lines.
    """
    known = Lines(white_um, lean=lean)
    gain, _ = _gain(known, energies, along)
    half = white_um / np.sqrt(2)
    with_drift, better = _climbed(replace(known, white_um=half, red_um=half, red_lines=4.0), energies, along)
    if with_drift.red_um**2 > SMALLEST * with_drift.offset_um**2 and special.chdtrc(2, max(better - gain, 0.0)) < LEVEL:
        known, gain = with_drift, better
    period, trials = _strongest_period(known, energies, along)
    share = known.offset_um / 2
    with_hum, better = _climbed(replace(known, hum_um=share, hum_lines=15.0, period_lines=period), energies, along)
    chance = min(trials * float(special.chdtrc(3, max(better - gain, 0.0))), 1.0)
    if with_hum.hum_um**2 > SMALLEST * with_hum.offset_um**2 and chance < LEVEL:
        known = with_hum
    return known


def _gain(lines: Lines, energies: np.ndarray, along: np.ndarray) -> tuple[float, np.ndarray]:
    """Return 2 ln L above that of no offsets, and its derivatives by the covariances of offsets, shape (lines,).

    With a = (I + G·K)⁻¹·c and P = (I + G·K)⁻¹·G: ∂/∂K = a·aᵀ − P, summed over all offsets that are as far apart.
    """
    places = np.arange(len(along))
    count, covariance = len(along), lines.covariance(len(along))
    factor, order = linalg.lu_factor(np.eye(count) + energies @ covariance, overwrite_a=True)
    solved = linalg.lu_solve((factor, order), np.column_stack([along, energies]), overwrite_b=True)
    answer, left = solved[:, 0], solved[:, 1:]
    apart = np.abs(np.subtract.outer(places, places)).ravel()
    gain = float(along @ covariance @ answer - np.log(np.abs(np.diag(factor))).sum())
    return gain, np.bincount(apart, (np.outer(answer, answer) - left).ravel())


def _climbed(start: Lines, energies: np.ndarray, along: np.ndarray) -> tuple[Lines, float]:
    """Return the most likely process with the parts that a start has, and its gain."""
    parts = ["white_um", *(["red_um", "red_lines"] if start.red_um else [])]
    parts += ["hum_um", "hum_lines", "period_lines"] if start.hum_um else []
    size = start.offset_um
    ends = {"red_lines": RED_LINES, "hum_lines": HUM_LINES, "period_lines": HUM_PERIODS}
    bounds = np.log([ends.get(name, (1e-3 * size, 10 * size)) for name in parts])
    begun = np.clip(np.log([max(getattr(start, name), 1e-300) for name in parts]), bounds[:, 0], bounds[:, 1])
    places, moves = np.arange(len(along)), STEP * np.eye(len(parts))

    def at(place: np.ndarray) -> Lines:
        return replace(start, **dict(zip(parts, np.exp(place).tolist(), strict=True)))

    def loss(place: np.ndarray) -> tuple[float, np.ndarray]:
        gain, far = _gain(at(place), energies, along)
        ends = [(at(place + move)._of_offsets(places), at(place - move)._of_offsets(places)) for move in moves]
        return -gain, np.array([-far @ (above - below) / (2 * STEP) for above, below in ends])

    minimum = optimize.minimize(loss, begun, jac=True, method="L-BFGS-B", bounds=bounds, options={"ftol": FLAT})
    return at(minimum.x), float(-minimum.fun)


def _strongest_period(lines: Lines, energies: np.ndarray, along: np.ndarray) -> tuple[float, float]:
    """Return the period whose swing stands out most beside a process, and how many independent ones there are."""
    count = len(along)
    root = lines.root(count)
    triangle = np.linalg.cholesky(np.eye(count) + root.T @ energies @ root)
    shrunk = linalg.solve_triangular(triangle, root.T, lower=True)
    inner = energies @ shrunk.T
    left, precision = along - inner @ (shrunk @ along), energies - inner @ inner.T
    periods = 1 / np.linspace(1 / HUM_PERIODS[1], 1 / HUM_PERIODS[0], 2 * count)
    gains = []
    for period in periods:
        phase = 2 * np.pi * lines.spacing * np.arange(count) / period
        waves = np.column_stack([np.cos(phase), np.sin(phase)])
        seen = waves.T @ left
        gains.append(seen @ np.linalg.pinv(waves.T @ precision @ waves, hermitian=True) @ seen)
    return float(periods[int(np.argmax(gains))]), lines.spacing * count / 2
