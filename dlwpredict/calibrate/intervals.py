"""How well the parameters are known: covariance under correlated noise, intervals, and what the data leave open.

The estimate minimises Σ w·r² over pixels; the noise of neighbouring pixels is correlated with covariance C. Then
(J'WJ)⁻¹ (J'W C W J) (J'WJ)⁻¹ is the covariance of the parameters (Huber's sandwich); (J'WJ)⁻¹σ² would be far too small.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from dlwpredict.calibrate.problem import Point, project
from dlwpredict.calibrate.recordings import Recording
from dlwpredict.flat import Free
from dlwpredict.noise import Noise, estimate

DRAWS = 12
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
        return stats.t.ppf(0.975, self.degrees_of_freedom)


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
    are found by drawing noise from the model, fitting it (linearly), and estimating it again: the mean ratio corrects
    the model, and the scatter of the resulting standard errors gives their degrees of freedom (Satterthwaite).
    """
    drawn = [_drawn_again(recordings, point, jacobian, noises, np.random.default_rng([seed, k])) for k in range(DRAWS)]
    corrected = [_corrected(noise, [d[k] for d in drawn]) for k, noise in enumerate(noises)]
    spread = [[_rescaled(noise, d[k], noises[k]) for k, noise in enumerate(corrected)] for d in drawn]
    variances = np.array([np.diag(sandwich(recordings, free, point, jacobian, s)) for s in spread])
    freedom = 2 / np.maximum(np.var(np.log(variances), axis=0, ddof=1), 1e-3)
    covariance = sandwich(recordings, free, point, jacobian, corrected)
    inflation = np.sqrt(np.maximum(variances.mean(axis=0) / np.diag(covariance), 1))
    return Information(covariance * np.outer(inflation, inflation), np.maximum(freedom, 2)), corrected


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
    return np.clip(intervals, free.low[:, None], free.high[:, None])


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


def _drawn_again(
    recordings: Sequence[Recording],
    point: Point,
    jacobian: Sequence[np.ndarray],
    noises: Sequence[Noise],
    rng: np.random.Generator,
) -> list[Noise]:
    """Draw noise, take out of it what a fit would, and estimate it again."""
    drawn = [
        project(r.columns, noise.simulate(r.used.shape, rng)[r.used][:, None], w)[:, 0]
        for r, noise, w in zip(recordings, noises, point.weights, strict=True)
    ]
    roots = [np.sqrt(w) for w in point.weights]
    stacked = np.concatenate([j * root[:, None] for j, root in zip(jacobian, roots, strict=True)])
    goal = np.concatenate([d * root for d, root in zip(drawn, roots, strict=True)])
    step = np.linalg.lstsq(stacked, goal, rcond=1e-10)[0]
    return [
        estimate([r.on_map(d - j @ step)], r.used, r.target.dx_um, r.target.dy_um, smoothness=noise.smoothness)
        for r, d, j, noise in zip(recordings, drawn, jacobian, noises, strict=True)
    ]


def _corrected(noise: Noise, drawn: Sequence[Noise]) -> Noise:
    """Return the noise with what the fit absorbed given back: scaled by model / mean of the estimates drawn from it."""

    def ratio(name: str) -> float:
        wanted = getattr(noise, name)
        return wanted / max(float(np.mean([getattr(d, name) for d in drawn])), 0.5 * wanted)

    return replace(
        noise,
        correlated_um=noise.correlated_um * max(ratio("correlated_um"), 1.0),
        length_um=noise.length_um * max(ratio("length_um"), 1.0),
    )


def _rescaled(noise: Noise, drawn: Noise, model: Noise) -> Noise:
    """Return the noise as it would have been estimated, had its estimate erred as the drawn one did."""
    ratio = [getattr(drawn, n) / getattr(model, n) for n in ("white_um", "correlated_um", "length_um")]
    return replace(
        noise,
        white_um=noise.white_um * ratio[0],
        correlated_um=noise.correlated_um * ratio[1],
        length_um=noise.length_um * ratio[2],
    )
