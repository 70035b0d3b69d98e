"""The noise of a recording: its strength and correlation, by restricted maximum likelihood.

What a recording differs from its prediction by is noise and model error. Model error is mostly smooth; so a free form
that is smooth in the coordinates that physics acts in is fitted along, and the likelihood of what it cannot follow is
maximised over nugget, σ and length. "Restricted" counts what the free form has taken from the noise too; without that
the length comes out short, and just that makes false alarms.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage, optimize, sparse, special

from dlwpredict.noise import Noise
from dlwpredict.whitening import Neighbourhood

DISCREPANCY_UM = 0.0015
"""Numerical difference between two honest computations of the same physics; no noise is taken to be smaller."""

SMOOTHNESSES = (0.5, 1.5, np.inf)
"""Kinds of correlation that are tried: a rough one, Matérn's, a Gaussian. Taken for Matérn's, noise that an instrument
has smoothed would come out three times as long."""

OUTLYING = 4.0
"""Whitened values beyond this are no noise: points like these, and those `LOUD_PX` around, have no say in the noise."""

LOUD_PX = 3

MOST_POINTS = 2500
"""Points whose conditional likelihood enters; more would sharpen the estimate beyond need."""


@dataclass(frozen=True)
class NoiseEstimate:
    """A noise model with its uncertainty.

    Parameters
    ----------
    model : Noise
    place, covariance : numpy.ndarray, shapes (3,), (3, 3)
        Logit of the correlated share of the variance, log length, log scale; and their covariance.
    source : str
        What it was estimated from: "repeats" or "residual".
    """

    model: Noise
    place: np.ndarray
    covariance: np.ndarray
    source: str

    def moved(self, step: np.ndarray) -> NoiseEstimate:
        """Return the estimate at another place, at most an e-fold away, shape of the step (3,)."""
        place = self.place + np.clip(step, -1, 1)
        return replace(self, model=_floored(_at(self.model, place)), place=place)

    def draw(self, rng: np.random.Generator) -> Noise:
        """Return a noise model that the data would allow as well."""
        step = np.clip(rng.multivariate_normal(np.zeros(3), self.covariance), -1, 1)
        return _floored(_at(self.model, self.place + step))


def estimate(
    values_um: np.ndarray,
    used: np.ndarray,
    pitch_um: tuple[float, float],
    smooth: np.ndarray,
    kinds: Sequence[float] = SMOOTHNESSES,
    *,
    source: str = "residual",
    seed: int = 0,
) -> NoiseEstimate:
    """Estimate the noise of a map.

    Parameters
    ----------
    values_um : numpy.ndarray, shape (rows, cols)
        Residual, or difference of two repeats over √2.
    used : numpy.ndarray of bool, shape (rows, cols)
    pitch_um : tuple of float
        (dx, dy).
    smooth : numpy.ndarray, shape (columns, rows, cols)
        What may be in the values besides noise.
    kinds : sequence of float
        Smoothnesses of the correlation that are tried.
    source : str
    seed : int
        Of the choice of points.
    """
    y, design = values_um[used], smooth[:, used].T
    neighbours = Neighbourhood(used, *pitch_um, near_px=2, far_px=(4, 8, 16))
    draw = np.random.default_rng(seed)
    likelihood = _Likelihood(neighbours, _some(np.arange(len(y)), draw), y, design)
    model, place = _searched(likelihood, Noise(1.0, 1.0, 1.0, *pitch_um, noise_from=source), kinds)
    quiet = likelihood.quiet(model)
    if len(quiet) < len(y):
        likelihood = replace(likelihood, chosen=_some(quiet, draw))
        model, place = _searched(likelihood, model, (model.smoothness,))
    pitch = float(np.sqrt(pitch_um[0] * pitch_um[1]))

    def deviance(place: np.ndarray) -> float:
        return likelihood.deviance(_at(model, place)) + _weak_prior(place, pitch)

    scatter = _spread_of(deviance, place) * len(y) / len(likelihood.chosen)
    return NoiseEstimate(_floored(model), place, scatter, source)


def _some(points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return at most `MOST_POINTS` of the points, in order."""
    return np.sort(rng.choice(points, MOST_POINTS, replace=False)) if len(points) > MOST_POINTS else points


def _searched(likelihood: _Likelihood, like: Noise, kinds: Sequence[float]) -> tuple[Noise, np.ndarray]:
    """Return the most likely model, over the kinds of correlation too, and its place."""
    pitch = float(np.sqrt(like.dx_um * like.dy_um))
    longest = pitch * np.sqrt(len(likelihood.values_um)) / 6
    grid = [np.array([share, np.log(length)]) for share in (-1.0, 2.0) for length in pitch * np.array([1.0, 3.0, 9.0])]
    best = np.inf
    for kind in kinds:
        template = replace(like, smoothness=kind)

        def profiled(place: np.ndarray, template: Noise = template) -> float:
            return likelihood.profiled(_at(template, np.array([*place, 0.0])))[0] + _weak_prior(place, pitch)

        start = min(grid, key=profiled)
        found = optimize.minimize(
            profiled, start, method="Nelder-Mead", bounds=[(-5, 7), (np.log(0.5 * pitch), np.log(longest))],
            options={"xatol": 0.02, "fatol": 0.2, "maxfev": 40,
                     "initial_simplex": start + np.array([[0, 0], [0.8, 0], [0, 0.4]])},
        )  # fmt: skip
        if found.fun < best:
            best = found.fun
            scale = likelihood.profiled(_at(template, np.array([*found.x, 0.0])))[1]
            place = np.array([*found.x, np.log(scale)])
            model = _at(template, place)
    return model, place


def _weak_prior(place: np.ndarray, pitch_um: float) -> float:
    """Return a penalty that settles what the data leave open: where nothing is correlated, the length is free."""
    return float((place[0] / 5) ** 2 + ((place[1] - np.log(3 * pitch_um)) / 2) ** 2)


@dataclass(frozen=True, eq=False)
class _Likelihood:
    """The restricted likelihood of chosen points given their neighbours.

    Parameters
    ----------
    neighbours : Neighbourhood
    chosen : numpy.ndarray of int
        Points whose conditional density enters.
    values_um : numpy.ndarray, shape (points,)
    design : numpy.ndarray, shape (points, columns)
        What may be in the values besides noise.
    """

    neighbours: Neighbourhood
    chosen: np.ndarray
    values_um: np.ndarray
    design: np.ndarray

    def profiled(self, model: Noise) -> tuple[float, float]:
        """Return the deviance at the best multiple of a model, and that multiple."""
        logs, squares, freedom = self._terms(model)
        return logs + freedom * np.log(squares / freedom), float(np.sqrt(squares / freedom))

    def deviance(self, model: Noise) -> float:
        """Return −2 ln L up to a constant."""
        logs, squares, _ = self._terms(model)
        return logs + squares

    def quiet(self, model: Noise) -> np.ndarray:
        """Return the points far from any whose whitened value is no noise; all of them where those are a third."""
        every = np.arange(len(self.values_um))
        white = _condition(self.values_um[:, None], self.neighbours, every, *self.neighbours.rows(model))[:, 0]
        loud = np.zeros(self.neighbours.used.shape, dtype=bool)
        loud[self.neighbours.used] = np.abs(white) > OUTLYING
        near = ndimage.binary_dilation(loud, iterations=LOUD_PX)[self.neighbours.used]
        return every if near.mean() > 1 / 3 else every[~near]

    def _terms(self, model: Noise) -> tuple[float, float, int]:
        """Return the log determinants, the whitened sum of squares beside the design, and the degrees of freedom.

        All are scaled from the chosen points up to all points: the design is one and is not scaled.
        """
        coefficients, variances = self.neighbours.rows(model, self.chosen)
        joined = np.column_stack([self.values_um, self.design])
        white = _condition(joined, self.neighbours, self.chosen, coefficients, variances)
        triangle = np.linalg.qr(white[:, [*range(1, white.shape[1]), 0]], mode="r")
        pivots, share = np.abs(np.diag(triangle)), len(self.values_um) / len(self.chosen)
        real = pivots[:-1] > 1e-9 * pivots[:-1].max(initial=1e-300)
        logs = share * np.log(variances).sum() + 2 * np.log(pivots[:-1][real]).sum()
        freedom = len(self.values_um) - int(real.sum())
        squares = pivots[-1] ** 2 * freedom / (len(self.chosen) - int(real.sum()))
        return float(logs), float(squares), freedom


def _condition(joined: np.ndarray, neighbours: Neighbourhood, chosen: np.ndarray,
               coefficients: np.ndarray, variances: np.ndarray) -> np.ndarray:  # fmt: skip
    """Return the whitened rows of the chosen points."""
    index, present = neighbours.index[chosen], neighbours.present[chosen]
    at, place = np.nonzero(present)
    matrix = sparse.csr_array((coefficients[at, place], (at, index[at, place])), shape=(len(chosen), len(joined)))
    return (joined[chosen] - matrix @ joined) / np.sqrt(variances)[:, None]


def _spread_of(deviance: Callable[[np.ndarray], float], place: np.ndarray) -> np.ndarray:
    """Return the covariance of a place: twice the inverse curvature of the deviance, kept positive."""
    step, size = 0.1, len(place)
    unit = step * np.eye(size)
    single = [(deviance(place + e), deviance(place - e)) for e in unit]
    at = deviance(place)
    hessian = np.diag([(up - 2 * at + down) / step**2 for up, down in single])
    for i in range(size):
        for j in range(i):
            both = deviance(place + unit[i] + unit[j])
            hessian[i, j] = hessian[j, i] = (both - single[i][0] - single[j][0] + at) / step**2
    values, vectors = np.linalg.eigh(hessian / 2)
    return vectors @ np.diag(1 / np.maximum(values, 4.0)) @ vectors.T


def _at(like: Noise, place: np.ndarray) -> Noise:
    """Return the model of (logit of the correlated share of the variance, log length, log scale)."""
    share, scale = special.expit(place[0]), np.exp(place[2])
    white, correlated = float(scale * np.sqrt(1 - share)), float(scale * np.sqrt(share))
    return replace(like, white_um=white, correlated_um=correlated, length_um=float(np.exp(place[1])))


def _floored(noise: Noise) -> Noise:
    """Return the model with the numerical discrepancy added."""
    return replace(noise, white_um=float(np.hypot(noise.white_um, DISCREPANCY_UM)))
