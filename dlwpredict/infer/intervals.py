"""95 % intervals of what was fitted.

Four things spread an estimate: noise, its model being an estimate too; what two honest computations differ by; priors
where the data leave a direction open; and what is doubted but not fitted. Whatever the noise model says, blocks of
the residual show how much scatter there is along an estimator (`Null.shown`); the larger of both is taken.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy.optimize import brentq

from dlwpredict.infer.descend import descend
from dlwpredict.infer.free import Free, fittable, with_values
from dlwpredict.infer.null import Null, numerical
from dlwpredict.infer.objective import Fit, Objective, Work
from dlwpredict.infer.trace import trace
from dlwpredict.numerics.smoothing import means_over
from dlwpredict.parameters import ParameterSet

NORMAL = 1.96
"""Standard deviations that a 95 % interval reaches to each side."""

CURVED = 0.25
"""A positive parameter whose standard deviation is more than this share of its value has its profile taken; one too
whose linear interval meets a bound."""

FARTHER, BETWEEN, CLOSE = 3, 6, 0.1
"""Places looked at for each end of a profile, farther out and then between, and how near √(rise in cost) must come."""


def deviations(
    fitted: Fit, null: Null, work: Work | None = None, doubts: Sequence[np.ndarray] | None = None
) -> np.ndarray:
    """Return the standard deviation of every free parameter, infinite where nothing tells it, shape (parameters,)."""
    estimators = fitted.estimators
    lengths = np.linalg.norm(estimators, axis=0)
    known = lengths > 0
    unit = estimators / np.where(known, lengths, 1)
    noise = null.shown(fitted, unit)
    open_to_priors = np.sum(unit[fitted.rows.data :] ** 2, axis=0)
    spread = np.sqrt(noise + numerical(fitted, unit) ** 2 + open_to_priors)
    return np.where(known, np.hypot(lengths * spread, considered(fitted, work or Work(), doubts)), np.inf)


def considered(fitted: Fit, work: Work, doubts: Sequence[np.ndarray] | None = None) -> np.ndarray:
    """Return the standard deviation that what is doubted but not fitted gives, shape (parameters,).

    How pixels are written and read a print hardly shows, less than computations differ by: an even chance anywhere
    between points and squares. What else is doubted stands in maps of one standard deviation each. All pass through the
    estimators (a parameter that is considered, not estimated: Schmidt, Adv. Control Syst. 3, 293, 1966).

    Parameters
    ----------
    fitted : Fit
    work : Work
        Counts the predictions.
    doubts : sequence of numpy.ndarray, shape (doubts, rows, cols), optional
        Of every recording, µm.
    """
    columns = [_written(fitted, work), _read(fitted), fitted.seen_in_all(doubts).T if doubts else None]
    rows = [np.atleast_2d(one @ fitted.estimators) for one in columns if one is not None]
    return np.linalg.norm(np.concatenate([np.zeros((1, len(fitted.vector))), *rows]), axis=0)


def _written(fitted: Fit, work: Work) -> np.ndarray | None:
    """Return one standard deviation of how pixels are written, about the middle: whitened rows; None where known."""
    process = fitted.parameters
    if process.readings.pixels != "either":
        return None
    squares = replace(process, readings=replace(process.readings, pixels="squares"))
    changes, points = [], sum(item.recording.target.heights_um.size for item in fitted.data)
    for item, known in zip(fitted.data, fitted.traces, strict=True):
        read = trace(item.recording.target, squares, known.numerics, known)
        work.predictions += read.work * item.recording.target.heights_um.size / points
        changes.append(np.nan_to_num(read.heights_um - known.heights_um)[None])
    return np.sqrt(1 / 12) * fitted.seen_in_all(changes)[:, 0] / (1 - process.readings.square_share)


def _read(fitted: Fit) -> np.ndarray | None:
    """Return one of how an instrument has read its pixels; None where it is known.

    A camera's are means, those of a scan may be points. `align` takes all for means; of a map that it has not laid the
    pixels are taken for points.
    """
    sides = [item.recording.read_px or item.recording.unsaid_px for item in fitted.data]
    if not any(sides):
        return None
    changes = []
    for side, known in zip(sides, fitted.traces, strict=True):
        mean = means_over(known.heights_um, side)
        changes.append(np.nan_to_num(mean - known.heights_um)[None])
    return np.sqrt(1 / 3) * fitted.seen_in_all(changes)[:, 0]


def linear(free: Free, vector: np.ndarray, sd: np.ndarray) -> np.ndarray:
    """Return intervals about a vector, shape (parameters, 2), cut at the bounds.

    A parameter that is positive by its bounds has its interval on the logarithm, which follows a badly known width
    better.
    """
    reach = NORMAL * sd
    ends = np.stack([vector - reach, vector + reach], axis=1)
    for k in np.flatnonzero((free.low > 0) & (vector > 0)):
        factor = np.exp(min(reach[k] / vector[k], 50.0))
        ends[k] = vector[k] / factor, vector[k] * factor
    return np.stack(free.cut(*ends.T), axis=1)


@dataclass(frozen=True, eq=False)
class Intervals:
    """95 % intervals of a fit.

    Parameters
    ----------
    names : tuple of str
    sd : numpy.ndarray, shape (parameters,)
    ends : numpy.ndarray, shape (parameters, 2)
    profiled : tuple of str
        Parameters whose interval is a profile's.
    """

    names: tuple[str, ...]
    sd: np.ndarray
    ends: np.ndarray
    profiled: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, tuple[float, float]]:
        """Return the ends by name."""
        return {name: (float(low), float(high)) for name, (low, high) in zip(self.names, self.ends, strict=True)}


def intervals(
    fitted: Fit,
    null: Null,
    objective: Objective | None = None,
    wanted: Sequence[str] | None = None,
    work: Work | None = None,
    doubts: Sequence[np.ndarray] | None = None,
) -> Intervals:
    """Return the intervals of a converged fit.

    Parameters
    ----------
    fitted : Fit
    null : Null
    objective : Objective, optional
        Where given, profiles are taken of the wanted parameters for which a straight line will not do.
    wanted : sequence of str, optional
        Default: all.
    work : Work, optional
        Counts the predictions; that of the objective counts those of profiles.
    doubts : sequence of numpy.ndarray, optional
        What `considered` takes into account besides pixels.
    """
    free, sd = fitted.free, deviations(fitted, null, work, doubts)
    ends, profiled = linear(free, fitted.vector, sd), []
    if objective is not None:
        for k in curved(fitted, sd):
            if wanted is None or free.names[k] in wanted:
                ends[k] = profile(objective, fitted, k, sd[k])
                profiled.append(free.names[k])
    return Intervals(free.names, sd, ends, tuple(profiled))


def curved(fitted: Fit, sd: np.ndarray) -> list[int]:
    """Return the parameters whose linear interval cannot be trusted."""
    free, vector = fitted.free, fitted.vector
    reach = NORMAL * np.where(np.isfinite(sd), sd, 0.0)
    wide = (free.low >= 0) & (vector > 0) & (sd > CURVED * vector)
    near = ((vector - reach < free.low) & (free.low < vector)) | ((vector + reach > free.high) & (vector < free.high))
    cyclic = np.array([fittable(free.base)[name].cyclic for name in free.names])
    return [int(k) for k in np.flatnonzero((wide | near) & np.isfinite(sd) & ~cyclic)]


def profile(objective: Objective, fitted: Fit, k: int, sd: float) -> tuple[float, float]:
    """Return the ends at which the best fit of all other parameters costs too much more.

    Where noise is as the model has it the cost may rise by 1.96²; here by as much more as the variance along the
    estimator is larger (the adjusted composite likelihood of Pace, Salvan & Sartori, Stat. Sin. 21, 129, 2011).
    """
    estimated = float(np.linalg.norm(fitted.estimators[:, k]))
    allowed = (NORMAL * sd / max(estimated, 1e-300)) ** 2
    ends = []
    for side in (-1, 1):
        bound = float(fitted.free.low[k] if side < 0 else fitted.free.high[k])
        ends.append(_end(objective, fitted, k, side * NORMAL * sd, allowed, bound))
    return ends[0], ends[1]


def _end(objective: Objective, fitted: Fit, k: int, reach: float, allowed: float, bound: float) -> float:
    """Return one end: farther out until the cost has risen too much, then by Brent's method between.

    √(rise in cost) is nearly straight, and a secant does; along a bent ridge it is not.
    """
    value = float(fitted.vector[k])

    @cache
    def beyond(place: float) -> float:
        """Return √(rise in cost), in units of the one allowed, less 1; 0 where that is near enough."""
        rise = max(held(objective, fitted, k, place, CLOSE * allowed) - fitted.cost, 0.0) if place != value else 0.0
        excess = float(np.sqrt(rise / allowed)) - 1
        return excess if abs(excess) > CLOSE else 0.0

    def limited(place: float, inside: float) -> float:
        """Keep a place inside the bound; what cannot be 0, a length, at most halves or doubles in one step."""
        low, high = sorted((value, bound))
        if fitted.free.low[k] > 0:
            low, high = max(low, inside / 2), min(high, 2 * inside)
        return float(np.clip(place, low, high))

    inside, place = value, limited(value + reach, value)
    for _ in range(FARTHER):
        if beyond(place) >= 0 or place == bound:
            break
        inside, place = place, limited(value + (place - value) / np.clip(1 + beyond(place), 0.3, 0.9), place)
    if beyond(place) <= 0:
        return place
    return float(brentq(beyond, inside, place, xtol=1e-3 * abs(place - inside), maxiter=BETWEEN, disp=False))


def held(objective: Objective, near: Fit, k: int, place: float, exact: float) -> float:
    """Return the profile of the objective: least cost with parameter k held at a place, by the Jacobian near by.

    A descent to it ends where the next step promises less than what the cost must be exact to.
    """
    free = near.free
    others = [i for i in range(len(free.names)) if i != k]
    base = _with(near.parameters, free, near.vector, k, place)
    part = Free(base, tuple(free.names[i] for i in others), free.low[others], free.high[others])
    begun = objective.at(part, part.allowed(part.start), near)
    fit = descend(objective, replace(begun, jacobian=near.jacobian[:, others]), secant=True, steps=4, gain=exact)
    prior = objective.known.get(free.names[k])
    return fit.cost + (prior.row(place)[0] ** 2 if prior else 0.0)


def _with(parameters: ParameterSet, free: Free, vector: np.ndarray, k: int, place: float) -> ParameterSet:
    """Return the process with one value moved; the other κ gives way."""
    moved = vector.copy()
    moved[k] = place
    low, high = free.index("shrinkage_min"), free.index("shrinkage_max")
    if low is not None and high is not None and moved[low] > moved[high]:
        moved[[low, high]] = place
    return with_values(parameters, dict(zip(free.names, moved, strict=True)))
