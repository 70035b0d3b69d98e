"""The noise of a recording: its strength and correlation, by restricted maximum likelihood.

What a recording differs from its prediction by is noise and model error. Model error is mostly smooth; so a free form
that is smooth in the coordinates that physics acts in is fitted along, and the likelihood of what it cannot follow is
maximised over nugget, σ and length. "Restricted" counts what the free form has taken from the noise too; without that
the length comes out short, and just that makes false alarms. Where noise grows on slopes, values are divided by how
much it does; where whole rows or columns have offsets or tilts of their own, the rest is estimated beside them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage, sparse

from dlwpredict.noise.covariance import Noise
from dlwpredict.noise.evened import Evened, Seen, Unevenness
from dlwpredict.noise.kinds import GRAINS_PX, SMOOTHNESSES, most_likely
from dlwpredict.noise.likelihood import Likelihood, model_at
from dlwpredict.noise.lines import OFFSET, TILT, Lines, on_lines
from dlwpredict.noise.replicas import repeated
from dlwpredict.noise.unevenness import Ground, Uneven
from dlwpredict.noise.whitening import Neighbourhood

DISCREPANCY_UM = 0.0015
"""Numerical difference between two honest computations of the same physics; no noise is taken to be smaller."""

Kinds = tuple[Sequence[float], Sequence[float]]

FLAT = Ground()

POWERS = (1.0, 2.0)
"""Ways in which noise may grow on slopes: in proportion, and by a jitter that is independent of it."""

OUTLYING = 4.0
"""Whitened values beyond this are no noise: points like these, and those `LOUD_PX` around, have no say in the noise."""

LOUD_PX = 3

READ, AVERAGED = 0.6, 0.5
"""Grain of a map that was read between the pixels of an instrument, in those: what neighbours share of white noise
(`kinds.GRAINS_PX`) makes it 0.57 to 0.69. And how wide they are, in pixels of the map, where each is a mean over enough
of them to have noise of its own."""

SPIKY = 0.005
"""Share of points lost beyond which kind and grain are chosen anew: chance takes a third of that, spikes made them."""

NEAR_PX, FAR_PX = 2, (4, 8, 16)
"""Neighbourhood of the estimate: smaller than that of the whitener, since many models are looked at."""

SEARCHED_POINTS, MOST_POINTS = 6000, 8000
"""Points whose conditional likelihood enters the search, and the estimate. In 154 maps of a spent proof the search
finds the kind of noise that was drawn in 143; on 2500 points in 136, for two thirds of the time."""


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
        How sure offsets of whole columns are, of a scan that is not known to run along them.
    kinds : dict
        −2 ln L by the smoothness of the correlation, of those that were tried.
    """

    model: Uneven
    place: np.ndarray
    covariance: np.ndarray
    source: str
    columns: Unevenness
    kinds: dict[float, float]

    def draw(self, rng: np.random.Generator) -> Uneven:
        """Return a noise model that the data would allow as well."""
        step = np.clip(rng.multivariate_normal(np.zeros(3), self.covariance), -1, 1)
        return replace(self.model, even=_floored(model_at(self.model.even, self.place + step)))


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
    apart = every
    if ground.read_px > AVERAGED:
        kinds = kinds[0], (READ * max(ground.read_px, 1.0),)
        apart = Neighbourhood.of(used, *pitch_um, NEAR_PX, FAR_PX, stride_px(ground))
    y, design = values_um[used], smooth[:, used].T
    ways = [(axis, order) for axis in ground.axes for order in (OFFSET, TILT)]
    members = {(axis, order): on_lines(used, axis, order, ground.lean) for axis, order in ways}
    even = Evened(y, design, members, np.broadcast_to(ground.slope, used.shape)[used], lean=ground.lean)
    some = _some(every.own, SEARCHED_POINTS, draw)
    start = Noise(1.0, 1.0, 3 * float(np.sqrt(np.prod(pitch_um))), *pitch_um)
    seen, model, place, by_kind = _searched(even, every, apart[some], start, *kinds)
    even, quiet = seen.even, _quiet(every.own, seen.near @ seen.left, used)
    if len(quiet) < len(y):
        likelihood = Likelihood.of(even, apart[_some(quiet, SEARCHED_POINTS, draw)], model)
        spiky = len(y) - len(quiet) > SPIKY * len(y)
        model, place, anew = most_likely(likelihood, model, *(kinds if spiky else same_kind(model)))
        by_kind = anew if spiky else by_kind
    likelihood = Likelihood.of(even, apart[_some(quiet, MOST_POINTS, draw)], model)
    places, centre = repeated(likelihood, used, even, model, place[:2], draw)
    place = places[0] - np.clip(places[1:].mean(axis=0) - centre, -1, 1)
    model = _floored(model_at(model, place))
    near, none = every.whitener(model), (Lines(), Unevenness(0.0, 0.0))
    (rows, _), (columns, surely) = (even.line_noise(near, axis) if axis in ground.axes else none for axis in (0, 1))
    uneven = Uneven(model, even.growth * model.sigma_um, even.power, rows, columns)
    surely = surely if 0 in ground.axes else none[1]
    return NoiseEstimate(uneven, place, np.cov(places[1:].T), source, surely, by_kind)


def stride_px(ground: Ground) -> int:
    """Return how many pixels apart points are that tell the noise: 1, or so many that none are read from the same."""
    return int(max(ground.read_px, 1.0)) + 1 if ground.read_px > AVERAGED else 1


def _searched(
    even: Evened,
    every: Neighbourhood,
    chosen: Neighbourhood,
    like: Noise,
    kinds: Sequence[float],
    grains_px: Sequence[float],
) -> tuple[Seen, Noise, np.ndarray, dict[float, float]]:
    """Return values made even and whitened, the most likely model of some of their points, its place, and the kinds.

    In which ways lines and slopes are uneven is told by the kind of correlation that was found first. Which kind it is
    beside them is asked in the end.
    """

    def likeliest(
        even: Evened, like: Noise, *kinds: Sequence[float]
    ) -> tuple[sparse.csr_array, Noise, np.ndarray, dict[float, float]]:
        model, place, by_kind = most_likely(Likelihood.of(even, chosen, like), like, *kinds)
        return every.whitener(model), model, place, by_kind

    first = even
    near, model, place, by_kind = likeliest(even, like, kinds, grains_px)
    while (evened := _more_even(even, near)) is not even:
        even = evened
        near, model, *_ = likeliest(even, model, *same_kind(model))
    if even is not first:
        even = even.resized(near) if even.ways else even  # what lines have had was in the whitener that told them
        near, model, place, by_kind = likeliest(even, model, kinds, grains_px)
    return even.seen(near), model, place, by_kind


def same_kind(model: Noise) -> Kinds:
    """Return the kind of correlation and the grain of a model, as all that is tried."""
    return (model.smoothness,), (model.grain_um / model.pitch_um,)


def _more_even(even: Evened, near: sparse.csr_array) -> Evened:
    """Look beside the means of rows or columns, then their tilts, whichever are more surely uneven; then on slopes."""
    seen = even.beside_all_of(even.ways, near).seen(near)
    left = [way for way in even.members if way not in even.ways]
    open_ways = [(axis, order) for axis, order in left if order == OFFSET or (axis, OFFSET) in even.ways]
    by_way = {way: seen.lines(way) for way in open_ways}
    if any(unevenness.found for unevenness in by_way.values()):
        way = max(by_way, key=lambda way: by_way[way].gain)
        return even.also(way, by_way[way].size, near)
    by_power = {power: seen.jitter(power) for power in POWERS} if not even.growth else {}
    if any(unevenness.found for unevenness in by_power.values()):
        power = max(by_power, key=lambda power: by_power[power].gain)
        return replace(even, growth=by_power[power].size, power=power)
    return even


def _some(points: np.ndarray, most: int, rng: np.random.Generator) -> np.ndarray:
    """Return at most so many of the points, in order; of all alike, else the design would count too much or little."""
    return np.sort(rng.choice(points, most, replace=False)) if len(points) > most else points


def _quiet(points: np.ndarray, white: np.ndarray, used: np.ndarray) -> np.ndarray:
    """Return the points far from any whose whitened value is no noise; all of them where those are a third."""
    loud = np.zeros(used.shape, dtype=bool)
    loud[used] = np.abs(white) > OUTLYING
    near = ndimage.binary_dilation(loud, iterations=LOUD_PX)[used]
    return points if near.mean() > 1 / 3 else points[~near]


def _floored(noise: Noise) -> Noise:
    """Return the model with the numerical discrepancy added."""
    return replace(noise, white_um=float(np.hypot(noise.white_um, DISCREPANCY_UM)))
