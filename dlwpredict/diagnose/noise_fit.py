"""The noise of a recording: its strength and correlation, by restricted maximum likelihood.

What a recording differs from its prediction by is noise and model error. Model error is mostly smooth; so a free form
that is smooth in the coordinates that physics acts in is fitted along, and the likelihood of what it cannot follow is
maximised over nugget, σ and length. "Restricted" counts what the free form has taken from the noise too; without that
the length comes out short, and just that makes false alarms. Where noise grows on slopes, values are divided by how
much it does; where whole rows or columns have offsets of their own, the rest is estimated beside their means.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import ndimage, optimize, sparse, special

from dlwpredict.diagnose.noise_uneven import Evened, Unevenness
from dlwpredict.noise import Noise
from dlwpredict.uneven import Uneven
from dlwpredict.whitening import Neighbourhood, lines

DISCREPANCY_UM = 0.0015
"""Numerical difference between two honest computations of the same physics; no noise is taken to be smaller."""

SMOOTHNESSES = (0.5, 1.5, np.inf)
"""Kinds of correlation that are tried: a rough one, Matérn's, a Gaussian. Taken for Matérn's, noise that an instrument
has smoothed would come out three times as long."""

GRAINS_PX = (0.0, 0.4, 0.5, 0.6, 0.7, 0.9, 1.2)
"""Grains that are tried, all of them: beside one too fine, noise of a wrong kind may be the likelier one. Of white
noise, neighbours then share 0, 4, 12, 22, 32, 49, 64 %. Read between its pixels by cubic convolution, they share 12 %
where the recording is 0.9 times as coarse as the map, 35 % where it is 1.2 times, 69 % where it is twice."""

CHANCE = 3.84
"""A grain is taken where −2 ln L of the points looked at falls by more: by chance in 5 % of cases."""

POWERS = (1.0, 2.0)
"""Ways in which noise may grow on slopes: in proportion, and by a jitter that is independent of it."""

OUTLYING = 4.0
"""Whitened values beyond this are no noise: points like these, and those `LOUD_PX` around, have no say in the noise."""

LOUD_PX = 3

SEARCHED_POINTS, MOST_POINTS = 2500, 8000
"""Points whose conditional likelihood enters the search, and the estimate."""

RECENTRED = 3
"""Times at most that the estimate starts again from where it has led."""

SMALL_STEP = np.array([0.2, 0.1])
"""Steps in the logit of the share and the logarithm of the length in which the deviance's curvature is looked at."""

REPLICATES = 24
"""Maps drawn from an estimate on which it is repeated, to learn its error."""


@dataclass(frozen=True)
class NoiseEstimate:
    """A noise model with its uncertainty.

    Parameters
    ----------
    model : Uneven
    place, covariance : numpy.ndarray, shapes (3,), (3, 3)
        Logit of the correlated share of the variance, log length, log scale; and their covariance, both by bootstrap.
    source : str
        What it was estimated from: "repeats" or "residual".
    columns : Unevenness
        Offsets of whole columns.
    """

    model: Uneven
    place: np.ndarray
    covariance: np.ndarray
    source: str
    columns: Unevenness

    def draw(self, rng: np.random.Generator) -> Uneven:
        """Return a noise model that the data would allow as well."""
        step = np.clip(rng.multivariate_normal(np.zeros(3), self.covariance), -1, 1)
        return replace(self.model, even=_floored(_at(self.model.even, self.place + step)))


def estimate(
    values_um: np.ndarray,
    used: np.ndarray,
    pitch_um: tuple[float, float],
    smooth: np.ndarray,
    kinds: Sequence[float] = SMOOTHNESSES,
    grains_px: Sequence[float] = GRAINS_PX,
    *,
    slope: np.ndarray | float = 0.0,
    source: str = "residual",
    seed: int = 0,
) -> NoiseEstimate:
    """Estimate the noise of a map.

    What may be in the values takes some of the noise with it, most where the noise is correlated widely. So noise is
    drawn from the estimate and estimated again in the same way; the mean error is taken back, the scatter is reported.

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
    grains_px : sequence of float
        Grains of the white part that are tried, in pixels.
    slope : numpy.ndarray, shape (rows, cols), or 0
        |∇f| of the surface.
    source : str
    seed : int
        Of the choice of points, and of the drawn noise.
    """
    y, design = values_um[used], smooth[:, used].T
    every = Neighbourhood.of(used, *pitch_um, near_px=2, far_px=(4, 8, 16))
    draw = np.random.default_rng(seed)
    likelihood = _Likelihood(every[_some(np.arange(len(y)), SEARCHED_POINTS, draw)], y[:, None], design)
    model, place = _searched(likelihood, Noise(1.0, 1.0, 1.0, *pitch_um, noise_from=source), kinds, grains_px)
    even = Evened(y, design, (lines(used, 0), lines(used, 1)), np.broadcast_to(slope, used.shape)[used])
    for step in (_along_lines, _along_lines, _on_slopes):
        found = step(even, every.whitener(model))
        if found is not even:
            even = found
            likelihood = replace(likelihood, values_um=even.of(y[:, None]), design=even.of(design))
            model, place = _searched(likelihood, model, kinds, grains_px)
    quiet = _quiet(every, likelihood.values_um[:, 0], used, model)
    if len(quiet) < len(y):
        likelihood = replace(likelihood, chosen=every[_some(quiet, SEARCHED_POINTS, draw)])
        model, place = _searched(likelihood, model, (model.smoothness,), (model.grain_um / model.pitch_um,))
    likelihood = replace(likelihood, chosen=every[_some(quiet, MOST_POINTS, draw)])
    for _ in range(RECENTRED):
        start = place
        place, repeated = _repeated(likelihood, used, even, _at(model, start), start, draw)
        if np.abs(place - start).max() < SMALL_STEP.min():
            break
    place = place - np.clip(repeated.mean(axis=0) - start, -1, 1)
    model = _floored(_at(model, place))
    near = every.whitener(model)
    rows, columns = (even.offsets(near, axis) for axis in (0, 1))
    uneven = Uneven(model, even.growth * model.sigma_um, even.power, rows.found, columns.found)
    return NoiseEstimate(uneven, place, np.cov(repeated.T), source, columns)


def _along_lines(even: Evened, near: sparse.csr_array) -> Evened:
    """Look beside the means of rows or of columns, whichever are more surely uneven and are not looked beside yet."""
    found = {axis: even.offsets(near, axis) for axis in (0, 1) if axis not in even.axes}
    axis = max(found, key=lambda one: found[one].gain)
    return replace(even, axes=(*even.axes, axis)) if found[axis].found else even


def _on_slopes(even: Evened, near: sparse.csr_array) -> Evened:
    """Divide by the growth on slopes that is likelier."""
    growths = {power: even.jitter(near, power) for power in POWERS}
    power = max(growths, key=lambda one: growths[one].gain)
    return replace(even, growth=growths[power].size, power=power) if growths[power].found else even


def _some(points: np.ndarray, most: int, rng: np.random.Generator) -> np.ndarray:
    """Return at most so many of the points, in order."""
    return np.sort(rng.choice(points, most, replace=False)) if len(points) > most else points


def _searched(
    likelihood: _Likelihood, like: Noise, kinds: Sequence[float], grains_px: Sequence[float]
) -> tuple[Noise, np.ndarray]:
    """Return the most likely model, over the kinds of correlation too, and its place."""
    best = np.inf
    for grain in grains_px:
        deviance, *found = _of_grain(likelihood, replace(like, grain_um=grain * like.pitch_um), kinds)
        deviance += CHANCE * likelihood.share if grain else 0
        if deviance < best:
            best, (model, place) = deviance, found
    return model, place


def _of_grain(likelihood: _Likelihood, like: Noise, kinds: Sequence[float]) -> tuple[float, Noise, np.ndarray]:
    """Return −2 ln L of the most likely model of one grain, the model, and its place."""
    pitch = like.pitch_um
    longest = pitch * np.sqrt(len(likelihood.values_um)) / 6
    lengths = np.minimum(pitch * np.array([1.0, 3.0, 9.0]), longest)
    grid = [np.array([share, np.log(length)]) for share in (-1.0, 2.0) for length in lengths]
    best = np.inf
    for kind in kinds:
        template = replace(like, smoothness=kind)

        def profiled(place: np.ndarray, template: Noise = template) -> float:
            deviance, _ = likelihood.profiled(_at(template, np.array([*place, 0.0])))
            return float(deviance[0]) + _weak_prior(place, pitch)

        start = min(grid, key=profiled)
        found = optimize.minimize(
            profiled, start, method="Nelder-Mead", bounds=[(-5, 7), (np.log(0.5 * pitch), np.log(longest))],
            options={"xatol": 0.05, "fatol": 1.0, "maxfev": 40,
                     "initial_simplex": start + np.array([[0, 0], [0.8, 0], [0, 0.4]])},
        )  # fmt: skip
        if found.fun < best:
            best = found.fun
            _, scale = likelihood.profiled(_at(template, np.array([*found.x, 0.0])))
            place = np.array([*found.x, np.log(scale[0])])
            model = _at(template, place)
    return best, model, place


def _weak_prior(place: np.ndarray, pitch_um: float) -> float:
    """Return a penalty that settles what the data leave open: where nothing is correlated, the length is free."""
    return float((place[0] / 5) ** 2 + ((place[1] - np.log(3 * pitch_um)) / 2) ** 2)


@dataclass(frozen=True, eq=False)
class _Likelihood:
    """The restricted likelihood of chosen points given their neighbours.

    Parameters
    ----------
    chosen : Neighbourhood
        Of the points whose conditional density enters.
    values_um : numpy.ndarray, shape (points, maps)
        One map or several, each with a likelihood of its own.
    design : numpy.ndarray, shape (points, columns)
        What may be in the values besides noise.
    """

    chosen: Neighbourhood
    values_um: np.ndarray
    design: np.ndarray

    @cached_property
    def together(self) -> np.ndarray:
        """Values and design side by side, shape (points, maps + columns)."""
        return np.column_stack([self.values_um, self.design])

    @property
    def share(self) -> float:
        """All points over those looked at."""
        return len(self.values_um) / len(self.chosen.own)

    def profiled(self, model: Noise) -> tuple[np.ndarray, np.ndarray]:
        """Return −2 ln L of every map, up to a constant, at the best multiple of a model, and that multiple.

        All terms are scaled from the chosen points up to all points: the design is one and is not scaled.
        """
        maps, points = self.values_um.shape[1], len(self.chosen.own)
        white, variances = self.chosen.whitened(self.together, model)
        values, columns = white[:, :maps], white[:, maps:]
        energies, turn = np.linalg.eigh(columns.T @ columns)
        real = energies > 1e-10 * energies.max(initial=1e-300)
        along = (turn[:, real] / np.sqrt(energies[real])).T @ (columns.T @ values)
        rank = int(real.sum())
        square = (np.sum(values**2, axis=0) - np.sum(along**2, axis=0)) / (points - rank)
        logs = self.share * np.log(variances).sum() + np.log(energies[real]).sum()
        return logs + (len(self.values_um) - rank) * np.log(square), np.sqrt(square)


def _quiet(every: Neighbourhood, values_um: np.ndarray, used: np.ndarray, model: Noise) -> np.ndarray:
    """Return the points far from any whose whitened value is no noise; all of them where those are a third."""
    white, _ = every.whitened(values_um[:, None], model)
    loud = np.zeros(used.shape, dtype=bool)
    loud[used] = np.abs(white[:, 0]) > OUTLYING
    near = ndimage.binary_dilation(loud, iterations=LOUD_PX)[used]
    return every.own if near.mean() > 1 / 3 else every.own[~near]


def _repeated(
    likelihood: _Likelihood,
    used: np.ndarray,
    even: Evened,
    model: Noise,
    place: np.ndarray,
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the place of the values themselves, (3,), and those found alike on maps drawn from a model, (maps, 3).

    For every map a quadratic in (share, length), through nine places around the model's own, stands for its deviance.
    """
    drawn = np.stack([model.simulate(used.shape, rng)[used] for _ in range(REPLICATES)], axis=1)
    drawn = even.beside_lines(drawn)
    every = replace(likelihood, values_um=np.column_stack([likelihood.values_um, drawn]))
    pitch = model.pitch_um

    def deviances(steps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        pairs = [every.profiled(_at(model, np.array([*(place[:2] + step), 0.0]))) for step in steps]
        prior = [_weak_prior(place[:2] + step, pitch) for step in steps]
        return np.array([d + p for (d, _), p in zip(pairs, prior, strict=True)]), np.log([scale for _, scale in pairs])

    cross, _ = deviances(SMALL_STEP * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]]))
    bend = (cross[1::2] + cross[2::2] - 2 * cross[0]).mean(axis=1) / SMALL_STEP**2 / 2
    step = np.clip(1.5 / np.sqrt(np.maximum(bend, 1e-12)), SMALL_STEP / 4, 5 * SMALL_STEP)
    a, b = nine = np.array([(a, b) for a in (-1, 0, 1) for b in (-1, 0, 1)], dtype=float).T
    terms = np.linalg.pinv(np.stack([np.ones(9), a, b, a**2 / 2, a * b, b**2 / 2], axis=1))
    places = []
    for (_, ga, gb, aa, ab, bb), scale in zip(*((terms @ part).T for part in deviances(step * nine.T)), strict=True):
        values, vectors = np.linalg.eigh(np.array([[aa, ab], [ab, bb]]))
        u, v = np.clip(-vectors @ (vectors.T @ np.array([ga, gb]) / np.maximum(values, 0.2)), -3, 3)
        height = scale @ np.array([1, u, v, u**2 / 2, u * v, v**2 / 2])
        places.append([*(place[:2] + step * (u, v)), height])
    return np.array(places[0]), np.array(places[1:])


def _at(like: Noise, place: np.ndarray) -> Noise:
    """Return the model of (logit of the correlated share of the variance, log length, log scale)."""
    share, scale = special.expit(place[0]), np.exp(place[2])
    white, correlated = float(scale * np.sqrt(1 - share)), float(scale * np.sqrt(share))
    return replace(like, white_um=white, correlated_um=correlated, length_um=float(np.exp(place[1])))


def _floored(noise: Noise) -> Noise:
    """Return the model with the numerical discrepancy added."""
    return replace(noise, white_um=float(np.hypot(noise.white_um, DISCREPANCY_UM)))
