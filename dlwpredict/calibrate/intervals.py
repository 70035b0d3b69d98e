"""How well the parameters are known: covariance under correlated noise, intervals, and what the data leave open.

The estimate minimises Σ w·r² over pixels; the noise of neighbouring pixels is correlated with covariance C. Then
(J'WJ)⁻¹ (J'W C W J) (J'WJ)⁻¹ is the covariance of the parameters (Huber's sandwich); (J'WJ)⁻¹σ² would be far too small.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from dlwpredict.calibrate.problem import Point, project
from dlwpredict.calibrate.recordings import Recording
from dlwpredict.flat import Free
from dlwpredict.noise import Noise, estimate, estimation_errors, scaled_each

DRAWS = 40
"""Noise maps that are drawn, fitted and analysed anew, per recording, to learn how well the noise itself is known."""

OPEN_SHARE = 0.1
"""A direction is open where its 95 % interval is longer than this share of the bounds either way."""


@dataclass(frozen=True, eq=False)
class Information:
    """What the data know about the parameters, to first order.

    Parameters
    ----------
    covariance : numpy.ndarray, shape (parameters, parameters)
        Of the estimate; the bounds enter as a wide prior, so that it stays finite.
    degrees_of_freedom : numpy.ndarray, shape (parameters,)
        Degrees of freedom of each standard error: the noise it rests on is itself an estimate.
    """

    covariance: np.ndarray
    degrees_of_freedom: np.ndarray

    @property
    def standard_errors(self) -> np.ndarray:
        """Return the standard error of every parameter."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def correlation(self) -> np.ndarray:
        """Return the correlation matrix of the estimate."""
        return self.covariance / np.outer(self.standard_errors, self.standard_errors)

    @property
    def quantiles(self) -> np.ndarray:
        """Return how many standard errors a 95 % interval reaches to each side."""
        return special.stdtrit(self.degrees_of_freedom, 0.975)


def noises_of(recordings: Sequence[Recording], point: Point) -> list[Noise]:
    """Estimate the noise of every recording from what the fit leaves of it."""
    return [
        estimate([r.on_map(residual)], r.used, r.target.dx_um, r.target.dy_um)
        for r, residual in zip(recordings, point.residuals, strict=True)
    ]


def inform(
    recordings: Sequence[Recording],
    free: Free,
    point: Point,
    jacobian: Sequence[np.ndarray],
    noises: Sequence[Noise],
    *,
    seed: int = 0,
) -> tuple[Information, list[Noise]]:
    """Return what the data know, and the noise models corrected for what the fit absorbed.

    A fit takes some of the noise, most at long wavelengths, and the noise left is known to some per cent only. Both
    are found by drawing noise from the model, fitting it (linearly), and estimating it again: the mean corrects the
    model, and the scatter of the resulting variances gives their degrees of freedom (Satterthwaite: 2/var ln V).
    """
    errors = _noise_errors(recordings, point, jacobian, noises, np.random.default_rng(seed))
    corrected = [_given_back(noise, e.mean(axis=0)) for noise, e in zip(noises, errors, strict=True)]
    covariance = sandwich(recordings, free, point, jacobian, corrected)
    scatter = np.zeros(len(free.names))
    for k, error in enumerate(errors):
        slopes = []
        for nearby in scaled_each(corrected[k], 1.05):
            changed = sandwich(recordings, free, point, jacobian, [*corrected[:k], nearby, *corrected[k + 1 :]])
            slopes.append(np.log(np.diag(changed) / np.diag(covariance)) / np.log(1.05))
        scatter += np.var((error - error.mean(axis=0)) @ np.array(slopes), axis=0)
    return Information(covariance, np.clip(2 / np.maximum(scatter, 1e-3), 3, None)), corrected


def _noise_errors(
    recordings: Sequence[Recording],
    point: Point,
    jacobian: Sequence[np.ndarray],
    noises: Sequence[Noise],
    rng: np.random.Generator,
) -> list[np.ndarray]:
    """Draw noise, take out of it what a fit would, and return how its estimates err, (draws, 3) per recording."""
    drawn = [
        project(r.columns, np.stack([noise.simulate(r.used.shape, rng)[r.used] for _ in range(DRAWS)], axis=1), w)
        for r, noise, w in zip(recordings, noises, point.weights, strict=True)
    ]
    roots = [np.sqrt(w)[:, None] for w in point.weights]
    stacked = np.concatenate([j * root for j, root in zip(jacobian, roots, strict=True)])
    goals = np.concatenate([d * root for d, root in zip(drawn, roots, strict=True)])
    steps = np.linalg.lstsq(stacked, goals, rcond=1e-10)[0]
    return [
        estimation_errors(noise, r.on_map((d - j @ steps).T), r.used)
        for r, noise, d, j in zip(recordings, noises, drawn, jacobian, strict=True)
    ]


def _given_back(noise: Noise, error: np.ndarray) -> Noise:
    """Return the noise with what the fit absorbed given back; it never gets smaller."""
    back = np.exp(np.maximum(-error, 0))
    return replace(noise, correlated_um=noise.correlated_um * back[1], length_um=noise.length_um * back[2])


def sandwich(
    recordings: Sequence[Recording],
    free: Free,
    point: Point,
    jacobian: Sequence[np.ndarray],
    noises: Sequence[Noise],
) -> np.ndarray:
    """Return the covariance of the estimate, the bounds as a wide prior; shape (parameters, parameters)."""
    width = free.high - free.low
    bread, filling = (part * np.outer(width, width) for part in bread_and_filling(recordings, point, jacobian, noises))
    filling += 1e-12 * np.trace(filling) * np.eye(len(width))
    information = bread @ np.linalg.solve(filling, bread) + np.eye(len(width))
    return np.linalg.inv((information + information.T) / 2) * np.outer(width, width)


def bread_and_filling(
    recordings: Sequence[Recording], point: Point, jacobian: Sequence[np.ndarray], noises: Sequence[Noise]
) -> tuple[np.ndarray, np.ndarray]:
    """Return J'WJ and J'WCWJ, shapes (parameters, parameters)."""
    bread = sum((j * w[:, None]).T @ j for j, w in zip(jacobian, point.weights, strict=True))
    filling = np.zeros_like(bread)
    for recording, j, w, noise in zip(recordings, jacobian, point.weights, noises, strict=True):
        maps = recording.on_map((j * w[:, None]).T)
        filling += np.tensordot(maps, noise.times(maps), axes=([1, 2], [1, 2]))
    return bread, filling


def linear_interval(free: Free, vector: np.ndarray, information: Information) -> np.ndarray:
    """Return the 95 % intervals, shape (parameters, 2), cut at the bounds.

    Where a parameter is positive the interval is taken on the logarithm, which follows a badly known width better.
    """
    reach = information.quantiles * information.standard_errors
    intervals = np.stack([vector - reach, vector + reach], axis=1)
    for k, low in enumerate(free.low):
        if low > 0 and vector[k] > 0:
            factor = np.exp(min(reach[k] / vector[k], 50.0))
            intervals[k] = vector[k] / factor, vector[k] * factor
    return np.stack(free.cut(*intervals.T), axis=1)


def open_directions(free: Free, information: Information) -> list[dict[str, float]]:
    """Return the directions that the data leave open, the widest first.

    Each is a change of parameters, name to µm or 1, one 95 % reach long; parameters that take little part are left
    out. They are the eigenvectors of the covariance in units of the bounds.
    """
    width = free.high - free.low
    values, vectors = np.linalg.eigh(information.covariance / np.outer(width, width))
    found = []
    for value, vector in zip(values[::-1], vectors.T[::-1], strict=True):
        reach = 1.96 * np.sqrt(max(value, 0))
        if reach < OPEN_SHARE:
            break
        sign = np.sign(vector[np.argmax(np.abs(vector))])
        part = np.abs(vector) > 0.15 * np.abs(vector).max()
        found.append({free.names[k]: float(sign * vector[k] * reach * width[k]) for k in np.flatnonzero(part)})
    return found
