"""The noise of a recording: its strength and correlation, by restricted maximum likelihood.

What a recording differs from its prediction by is noise and model error. Model error is mostly smooth; so a free form
that is smooth in the coordinates that physics acts in is fitted along, and the likelihood of what it cannot follow is
maximised over nugget, σ and length. "Restricted" counts what the free form has taken from the noise too; without that
the length comes out short, and just that makes false alarms. Where noise grows on slopes, values are divided by how
much it does; where whole rows or columns have offsets or tilts of their own, the rest is estimated beside them.

Points are looked at given their neighbours, many models at once: where most points have the same neighbours, a model
costs little more than one product of the whitened design with itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage, sparse, special

from dlwpredict.noise.covariance import Noise
from dlwpredict.noise.lines import Lines
from dlwpredict.noise.unevenness import OFFSET, TILT, Evened, Ground, Seen, Uneven, Unevenness, orthonormal
from dlwpredict.noise.whitening import Neighbourhood, lines

DISCREPANCY_UM = 0.0015
"""Numerical difference between two honest computations of the same physics; no noise is taken to be smaller."""

Kinds = tuple[Sequence[float], Sequence[float]]

FLAT = Ground()

SMOOTHNESSES = (0.5, 1.5, np.inf)
"""Kinds of correlation that are tried: a rough one, Matérn's, a Gaussian. Taken for Matérn's, noise that an instrument
has smoothed would come out three times as long."""

GRAINS_PX = (0.0, 0.4, 0.5, 0.6, 0.7, 0.9, 1.2)
"""Grains that are tried, until a coarser one is less likely. Of white noise, neighbours then share 0, 4, 12, 22, 32,
49, 64 %. Read between its pixels by cubic convolution, they share 12 % where the recording is 0.9 times as coarse as
the map, 35 % where it is 1.2 times, 69 % where it is twice."""

WITHOUT_GAIN = 2
"""Grains in a row without gain that end the search: the finest hardly differs from none, and its gain may be hidden."""

CHANCE = 3.84
"""A grain is taken where −2 ln L of the points looked at falls by more: by chance in 5 % of cases."""

POWERS = (1.0, 2.0)
"""Ways in which noise may grow on slopes: in proportion, and by a jitter that is independent of it."""

OUTLYING = 4.0
"""Whitened values beyond this are no noise: points like these, and those `LOUD_PX` around, have no say in the noise."""

LOUD_PX = 3

SPIKY = 0.005
"""Share of points lost beyond which kind and grain are chosen anew: chance takes a third of that, spikes made them."""

NEAR_PX, FAR_PX = 2, (4, 8, 16)
"""Neighbourhood of the estimate: smaller than that of the whitener, since many models are looked at."""

SEARCHED_POINTS, MOST_POINTS = 2500, 8000
"""Points whose conditional likelihood enters the search, and the estimate."""

SHARES, LENGTHS_PX = (-1.5, 0.5, 2.5), (1.0, 2.0, 4.0, 8.0)
"""Logits of the share and lengths where the search begins: two of the first steps apart, so parabolas meet."""

SHARES_WITHIN = (-5.0, 7.0)
"""Of the logit of the share: beyond, one part is less than a hundredth of the variance, and hardly matters."""

STEPS = np.array([[0.8, 0.35], [0.4, 0.2], [0.2, 0.1]])
"""Steps in the logit of the share and the logarithm of the length of the parabolas that lead to the maximum."""

NINE = np.array([(a, b) for a in (-1, 0, 1) for b in (-1, 0, 1)], dtype=float)
"""Places of a parabola, in steps."""

PARABOLA = np.linalg.pinv(
    np.stack([np.ones(9), *NINE.T, NINE[:, 0] ** 2 / 2, NINE.prod(axis=1), NINE[:, 1] ** 2 / 2], 1)
)
"""From its values there to 1, u, v, u²/2, u·v, v²/2."""

ROUNDING = 1e-6
"""Of products with seven digits of columns of unit size."""

RECENTRED = 4
"""Times at most that the estimate starts again from where it has led."""

REPLICATES = 24
"""Maps drawn from an estimate on which it is repeated, to learn its error."""

_NOTHING = 1e-12
_BLOCK, _MODELS = 512, 32
"""Points and models at a time, to bound memory: a block fits the cache."""


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
        How sure offsets of whole columns are.
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
    kinds: Kinds = (SMOOTHNESSES, GRAINS_PX),
    *,
    ground: Ground = FLAT,
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
    kinds : two sequences of float
        Smoothnesses of the correlation that are tried, and grains of the white part in pixels, in ascending order.
    ground : Ground
    source : str
    seed : int
        Of the choice of points, and of the drawn noise.
    """
    draw = np.random.default_rng(seed)
    every = Neighbourhood.of(used, *pitch_um, near_px=NEAR_PX, far_px=FAR_PX)
    y, design = values_um[used], smooth[:, used].T
    members = {(axis, order): lines(used, axis, order) for axis in ground.axes for order in (OFFSET, TILT)}
    even = Evened(y, design, members, np.broadcast_to(ground.slope, used.shape)[used])
    some = _some(every.own, SEARCHED_POINTS, draw)
    start = Noise(1.0, 1.0, 3 * float(np.sqrt(np.prod(pitch_um))), *pitch_um, noise_from=source)
    seen, model, place = _searched(even, every, some, start, *kinds)
    even, quiet = seen.even, _quiet(every.own, seen.near @ seen.left, used)
    if len(quiet) < len(y):
        likelihood = _Likelihood.of(even, every[_some(quiet, SEARCHED_POINTS, draw)], model)
        same = (model.smoothness,), (model.grain_um / model.pitch_um,)
        again = kinds if len(y) - len(quiet) > SPIKY * len(y) else same
        model, place = _most_likely(likelihood, model, *again)
    likelihood = _Likelihood.of(even, every[_some(quiet, MOST_POINTS, draw)], model)
    places, centre = _repeated(likelihood, used, even, model, place[:2], draw)
    place = places[0] - np.clip(places[1:].mean(axis=0) - centre, -1, 1)
    model = _floored(_at(model, place))
    near, none = every.whitener(model), (Lines(), Unevenness(0.0, 0.0))
    (rows, _), (columns, surely) = (even.found(near, axis) if axis in ground.axes else none for axis in (0, 1))
    uneven = Uneven(model, even.growth * model.sigma_um, even.power, rows, columns)
    return NoiseEstimate(uneven, place, np.cov(places[1:].T), source, surely)


def _searched(
    even: Evened,
    every: Neighbourhood,
    some: np.ndarray,
    like: Noise,
    kinds: Sequence[float],
    grains_px: Sequence[float],
) -> tuple[Seen, Noise, np.ndarray]:
    """Return values made even and whitened, the most likely model of some of their points, and its place."""
    chosen = every[some]
    model, place = _most_likely(_Likelihood.of(even, chosen, like), like, kinds, grains_px)
    seen = even.seen(every.whitener(model))
    while (found := _more_even(seen)) is not seen.even:
        model, place = _most_likely(_Likelihood.of(found, chosen, model), model, kinds, grains_px)
        seen = found.seen(every.whitener(model))
    return seen, model, place


def _more_even(seen: Seen) -> Evened:
    """Look beside the means of rows or columns, then their tilts, whichever are more surely uneven; then on slopes."""
    even = seen.even
    left = [way for way in even.members if way not in even.ways]
    open_ways = [(axis, order) for axis, order in left if order == OFFSET or (axis, OFFSET) in even.ways]
    lines_found = {way: seen.lines(way) for way in open_ways}
    if any(one.found for one in lines_found.values()):
        return replace(even, ways=(*even.ways, max(lines_found, key=lambda way: lines_found[way].gain)))
    growths = {power: seen.jitter(power) for power in POWERS} if not even.growth else {}
    if any(one.found for one in growths.values()):
        power = max(growths, key=lambda one: growths[one].gain)
        return replace(even, growth=growths[power].size, power=power)
    return even


def _some(points: np.ndarray, most: int, rng: np.random.Generator) -> np.ndarray:
    """Return at most so many of the points, in order; of all alike, else the design would count too much or little."""
    return np.sort(rng.choice(points, most, replace=False)) if len(points) > most else points


def _most_likely(
    likelihood: _Likelihood, like: Noise, kinds: Sequence[float], grains_px: Sequence[float]
) -> tuple[Noise, np.ndarray]:
    """Return the most likely model, over the kinds of correlation and the grains, and its place.

    From grain to grain, every kind goes on from where it was, until `WITHOUT_GAIN` have been no likelier.
    """
    templates = [replace(like, smoothness=kind, grain_um=grains_px[0] * like.pitch_um) for kind in kinds]
    lengths = np.minimum(np.log(like.pitch_um * np.array(LENGTHS_PX)), likelihood.bounds(like.pitch_um)[1, 1])
    grid = np.array([(share, length) for share in SHARES for length in lengths])
    rough, _ = likelihood.profiled([(one, place) for one in templates for place in grid])
    ends = _polished(likelihood, templates, grid[rough[:, 0].reshape(len(kinds), -1).argmin(axis=1)], STEPS)
    tried = [_lowest(ends, templates)]
    for grain in grains_px[1:]:
        templates = [replace(one, grain_um=grain * like.pitch_um) for one in templates]
        ends = _polished(likelihood, templates, [end[:2] for _, end in ends], STEPS[1:])
        tried.append(_lowest(ends, templates))
        if int(np.argmin([deviance for deviance, _, _ in tried])) < len(tried) - WITHOUT_GAIN:
            break
    leads = [CHANCE * likelihood.share if model.grain_um else 0.0 for _, _, model in tried]
    number = int(np.argmin([deviance + lead for (deviance, _, _), lead in zip(tried, leads, strict=True)]))
    _, place, model = tried[number]
    return _at(model, place), place


def _lowest(ends: Sequence[tuple[float, np.ndarray]], templates: Sequence[Noise]) -> tuple[float, np.ndarray, Noise]:
    """Return −2 ln L, place and template of the most likely of models."""
    number = int(np.argmin([deviance for deviance, _ in ends]))
    return *ends[number], templates[number]


@dataclass(frozen=True, eq=False)
class _Likelihood:
    """The restricted likelihood of chosen points given their neighbours.

    Parameters
    ----------
    chosen : Neighbourhood
        Of the points whose conditional density enters.
    table : numpy.ndarray of float32, shape (points, maps + columns)
        One map or several, each with a likelihood of its own, and what may be in them besides noise. The columns are
        orthonormal where a model near the likely ones has whitened them, so that seven digits are enough.
    maps : int
    """

    chosen: Neighbourhood
    table: np.ndarray
    maps: int

    @classmethod
    def of(cls, even: Evened, chosen: Neighbourhood, near: Noise) -> _Likelihood:
        """Return the likelihood of values that have been made even; a model near the likely ones is known."""
        values, design = even.of(even.values_um[:, None]), even.of(even.design)
        coefficients, variances = chosen.rows(near)
        index, size = chosen.index, len(chosen.own)
        ends = np.arange(size + 1) * index.shape[1]
        matrix = sparse.csr_array((coefficients.ravel(), index.ravel() % len(values), ends), shape=(size, len(values)))
        root = np.sqrt(variances)[:, None]
        white = [(part[chosen.own] - matrix @ part) / root for part in (values, design)]
        basis, turn = orthonormal(white[1])
        values = values - design @ (turn @ (basis.T @ white[0]))
        return cls(chosen, np.column_stack([values, design @ turn]).astype(np.float32), 1)

    def beside(self, maps: np.ndarray) -> _Likelihood:
        """Return the likelihood of further maps (points, maps) too."""
        return replace(
            self,
            table=np.column_stack([self.table[:, : self.maps], maps.astype(np.float32), self.table[:, self.maps :]]),
            maps=self.maps + maps.shape[1],
        )

    @property
    def share(self) -> float:
        """All points over those looked at."""
        return len(self.table) / len(self.chosen.own)

    def bounds(self, pitch_um: float) -> np.ndarray:
        """Return least and largest place, (2, 2): longer than a sixth of the map, no length can be told."""
        ends = np.log(pitch_um * np.array([0.5, np.sqrt(len(self.table)) / 6]))
        return np.column_stack([SHARES_WITHIN, ends])

    def profiled(self, trials: Sequence[tuple[Noise, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
        """Return −2 ln L at the best multiple of each model, and the logarithm of that multiple, (models, maps).

        Up to a constant, with a weak prior. All terms are scaled from the chosen points up to all points: the design is
        one and is not scaled.

        Parameters
        ----------
        trials : sequence of (Noise, place)
            Templates, and logit of the share and log length.
        """
        found = [self._some_profiled(trials[k : k + _MODELS]) for k in range(0, len(trials), _MODELS)]
        deviances, scales = (np.concatenate(parts) for parts in zip(*found, strict=True))
        return deviances + _weak_prior(trials)[:, None], scales

    def _some_profiled(self, trials: Sequence[tuple[Noise, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
        models = [_at(model, np.array([*place, 0.0])) for model, place in trials]
        coefficients, variances = self.chosen.of_patterns(models)
        products = self._products(coefficients, variances)
        m, points = self.maps, len(self.chosen.own)
        rank = products.shape[1] - m
        sizes = np.sqrt(np.maximum(np.diagonal(products, axis1=1, axis2=2), _NOTHING))
        products /= sizes[:, :, None] * sizes[:, None, :]  # else rounding of the largest would swamp the smallest
        root = np.linalg.cholesky(products[:, m:, m:] + ROUNDING * np.eye(rank))
        along = np.linalg.solve(root, products[:, m:, :m])
        left = np.maximum(1 - np.sum(along**2, axis=1), _NOTHING)  # a map may be nothing but what the design holds
        squares = sizes[:, :m] ** 2 * left / (points - rank)
        logs = self.share * np.log(variances) @ self.chosen.patterns[2]
        logs += 2 * np.log(np.diagonal(root, axis1=1, axis2=2) * sizes[:, m:]).sum(axis=1)
        return logs[:, None] + (len(self.table) - rank) * np.log(squares), np.log(squares) / 2

    def _products(self, coefficients: np.ndarray, variances: np.ndarray) -> np.ndarray:
        """Return the whitened table's products with itself, (models, columns, columns), of `of_patterns`."""
        rows = np.concatenate([np.ones((*variances.shape, 1)), -coefficients], axis=2) / np.sqrt(variances)[..., None]
        rows = np.ascontiguousarray(rows.swapaxes(0, 1), dtype=np.float32)
        place = self.chosen.patterns[1]
        index = np.column_stack([self.chosen.own, self.chosen.index])
        width = self.table.shape[1]
        products = np.zeros((len(variances), width, width))
        for first in range(0, len(index), _BLOCK):
            block = slice(first, first + _BLOCK)
            white = rows[place[block]] @ self.table[index[block]]
            products += white.transpose(1, 2, 0) @ white.transpose(1, 0, 2)
        return products


def _weak_prior(trials: Sequence[tuple[Noise, np.ndarray]]) -> np.ndarray:
    """Return a penalty that settles what the data leave open: where nothing is correlated, the length is free."""
    lengths = np.array([place[1] - np.log(3 * model.pitch_um) for model, place in trials])
    return (np.array([place[0] for _, place in trials]) / 5) ** 2 + (lengths / 2) ** 2


def _polished(
    likelihood: _Likelihood, templates: Sequence[Noise], places: Sequence[np.ndarray], steps: np.ndarray
) -> list[tuple[float, np.ndarray]]:
    """Return −2 ln L and place (with the scale) where parabolas of ever smaller steps lead, of each template."""
    low, high = likelihood.bounds(templates[0].pitch_um)
    for step in steps:
        around = [(model, place + step * one) for model, place in zip(templates, places, strict=True) for one in NINE]
        deviances, _ = likelihood.profiled(around)
        moves = [_lowest_of(PARABOLA @ nine, 2.0) for nine in deviances[:, 0].reshape(-1, 9)]
        places = [np.clip(place + step * move, low, high) for place, move in zip(places, moves, strict=True)]
    deviances, scales = likelihood.profiled(list(zip(templates, places, strict=True)))
    return list(zip(deviances[:, 0], np.column_stack([places, scales[:, 0]]), strict=True))


def _lowest_of(terms: np.ndarray, furthest: float) -> np.ndarray:
    """Return where a parabola is lowest, in steps, or in that direction where it does not bend upwards."""
    _, along, across, aa, ab, bb = terms
    values, vectors = np.linalg.eigh(np.array([[aa, ab], [ab, bb]]))
    move = -vectors @ (vectors.T @ np.array([along, across]) / np.maximum(values, 0.2))
    return np.clip(move, -furthest, furthest)


def _repeated(
    likelihood: _Likelihood, used: np.ndarray, even: Evened, model: Noise, place: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Return the places of the values themselves and of maps drawn from a model near them, and the model's own, (3,).

    For every map a quadratic in (share, length), through nine places around the model's own, stands for its deviance.
    """
    low, high = likelihood.bounds(model.pitch_um)
    step = STEPS[-1]
    for _ in range(RECENTRED):
        before = place
        ((*found, scale),), bend = _parabolic(likelihood, model, place, step)
        place = np.clip(found, low, high)
        step = np.clip(1.5 / np.sqrt(np.maximum(bend, 1e-12)), STEPS[-1] / 4, 5 * STEPS[-1])
        if np.abs(place - before).max() < STEPS[-1].min():
            break
    centre = np.array([*place, scale])
    drawn = _at(model, centre).simulate_many(used.shape, rng, REPLICATES)[:, used].T
    places, _ = _parabolic(likelihood.beside(even.beside_lines(drawn)), model, place, step)
    return places, centre


def _parabolic(
    likelihood: _Likelihood, model: Noise, place: np.ndarray, step: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the most likely place of every map (maps, 3), and how its −2 ln L bends along share and length."""
    deviances, scales = likelihood.profiled([(model, place + step * one) for one in NINE])
    terms = PARABOLA @ deviances
    moves = np.array([_lowest_of(one, 3.0) for one in terms.T])
    u, v = moves.T
    heights = np.sum(np.stack([np.ones(len(u)), u, v, u**2 / 2, u * v, v**2 / 2]) * (PARABOLA @ scales), axis=0)
    return np.column_stack([place + step * moves, heights]), terms[[3, 5]].mean(axis=1) / step**2 / 2


def _quiet(points: np.ndarray, white: np.ndarray, used: np.ndarray) -> np.ndarray:
    """Return the points far from any whose whitened value is no noise; all of them where those are a third."""
    loud = np.zeros(used.shape, dtype=bool)
    loud[used] = np.abs(white) > OUTLYING
    near = ndimage.binary_dilation(loud, iterations=LOUD_PX)[used]
    return points if near.mean() > 1 / 3 else points[~near]


def _at(like: Noise, place: np.ndarray) -> Noise:
    """Return the model of (logit of the correlated share of the variance, log length, log scale)."""
    share, scale = special.expit(place[0]), np.exp(place[2])
    white, correlated = float(scale * np.sqrt(1 - share)), float(scale * np.sqrt(share))
    return replace(like, white_um=white, correlated_um=correlated, length_um=float(np.exp(place[1])))


def _floored(noise: Noise) -> Noise:
    """Return the model with the numerical discrepancy added."""
    return replace(noise, white_um=float(np.hypot(noise.white_um, DISCREPANCY_UM)))
