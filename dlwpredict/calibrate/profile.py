"""Intervals where a straight line will not do: the likelihood profile of one parameter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import ndtr, ndtri

from dlwpredict.calibrate.descend import descend
from dlwpredict.calibrate.intervals import Information, bread_and_filling
from dlwpredict.calibrate.problem import Point, Problem
from dlwpredict.calibrate.straight import bending
from dlwpredict.flat import Free, with_values
from dlwpredict.noise import Noise

STEPS_OUT = 7
"""Most places tried to each side."""

CLOSE = 0.1
"""An end is found when its rise in cost is this near to the one asked for."""

GAIN = 1e-4
"""The others are fitted until this share of the cost is promised at most; the rise asked for is ten times that."""


def profile_intervals(
    problem: Problem,
    point: Point,
    jacobian: Sequence[np.ndarray],
    information: Information,
    noises: Sequence[Noise],
    *,
    chosen: Sequence[int],
    linear: np.ndarray,
) -> np.ndarray:
    """Return 95 % intervals, those of the chosen parameters from their likelihood profile.

    An end lies where the best fit of all others costs too much more. With independent noise the cost may rise by
    t²σ²; here noise is correlated, and the rise allowed is t²·(B⁻¹GB⁻¹)_kk/(B⁻¹)_kk with B = J'WJ and G = J'WCWJ, so
    that on a straight line the interval is the linear one (the adjusted composite likelihood of Pace, Salvan &
    Sartori, Stat. Sin. 21, 129, 2011). An end that the bounds cut off is the bound. Every place visited on the way
    that costs little enough belongs to the intervals of the other parameters as well, and widens them.

    Parameters
    ----------
    problem : Problem
    point : Point
        The solution.
    jacobian : sequence of numpy.ndarray
        There.
    information : Information
    noises : sequence of Noise
    chosen : sequence of int
        Places of the parameters to profile.
    linear : numpy.ndarray, shape (parameters, 2)
        Linear intervals.
    """
    allowed = _allowed_rise(problem, point, jacobian, information, noises)
    turned = [j @ bending(problem.free, point.vector) for j in jacobian]
    intervals, visited = linear.copy(), []
    for k in chosen:
        reach = information.quantiles[k] * information.standard_errors[k]
        for side in (-1, 1):
            end, places = _end(problem, point, turned, k, reach=reach, allowed=allowed[k], side=side)
            intervals[k, max(side, 0)] = end
            visited += places
    for place in visited:
        within = place.cost - point.cost <= allowed
        intervals[within, 0] = np.minimum(intervals[within, 0], place.vector[within])
        intervals[within, 1] = np.maximum(intervals[within, 1], place.vector[within])
    return intervals


def _allowed_rise(
    problem: Problem,
    point: Point,
    jacobian: Sequence[np.ndarray],
    information: Information,
    noises: Sequence[Noise],
) -> np.ndarray:
    """Return by how much the cost may rise for every parameter, µm², shape (parameters,)."""
    width = problem.free.high - problem.free.low
    bread, filling = (
        part * np.outer(width, width) for part in bread_and_filling(problem.recordings, point, jacobian, noises)
    )
    inverse = np.linalg.inv(bread + 1e-10 * np.trace(bread) * np.eye(len(width)))
    return information.quantiles**2 * np.diag(inverse @ filling @ inverse) / np.diag(inverse)


def _end(
    problem: Problem,
    point: Point,
    jacobian: Sequence[np.ndarray],
    k: int,
    *,
    reach: float,
    allowed: float,
    side: int,
) -> tuple[float, list[Point]]:
    """Return one end, and the places visited: √(rise in cost) is nearly straight, so the next place is the secant's."""
    value = point.vector[k]
    limit = problem.free.low[k] if side < 0 else problem.free.high[k]
    if value == limit:
        return float(limit), []
    inside, rise_inside, best = value, 0.0, point
    outside, rise_outside = None, 0.0
    visited: list[Point] = []
    place = _near(value + side * reach, value, problem.free.low[k], problem.free.high[k])
    for _ in range(STEPS_OUT):
        found = _at(problem, best, jacobian, k, place)
        visited.append(found)
        rise = np.sqrt(max(found.cost - point.cost, 0.0) / allowed)
        if abs(rise - 1) < CLOSE or (place == limit and rise < 1):
            return float(place), visited
        if rise < 1:
            inside, rise_inside, best = place, rise, found
        else:
            outside, rise_outside = place, rise
        if outside is None:
            place = value + (inside - value) / np.clip(rise, 0.25, 0.8)
        else:
            share = np.clip((1 - rise_inside) / (rise_outside - rise_inside), 0.1, 0.9)
            place = inside + share * (outside - inside)
        place = _near(place, inside, problem.free.low[k], problem.free.high[k])
    return float(limit if outside is None else outside), visited


def _near(place: float, inside: float, low: float, high: float) -> float:
    """Return the place inside the bounds; a positive parameter at most halves or doubles in one step."""
    if low > 0 and inside > 0:
        low, high = max(low, inside / 2), min(high, 2 * inside)
    return float(np.clip(place, low, high))


def _at(problem: Problem, near: Point, jacobian: Sequence[np.ndarray], k: int, place: float) -> Point:
    """Return the best fit with one parameter held; the full vector stays in it."""
    free = problem.free
    rest = [i for i in range(len(free.names)) if i != k]
    held = with_values(free.base, _consistent(free, near.vector, k, place))
    names = tuple(free.names[i] for i in rest)
    part = replace(problem, free=Free(held, names, free.low[rest], free.high[rest]), work=0.0, watch=None)
    start = part.at(part.free.allowed(part.free.start), near)
    found = descend(part, start, gain=GAIN, iterations=4, jacobian=[j[:, rest] for j in jacobian])
    problem.work += part.work
    return replace(found, vector=np.insert(found.vector, k, place))


def _consistent(free: Free, vector: np.ndarray, k: int, place: float) -> dict[str, float]:
    """Return values by name with one moved; the other κ gives way, and the threshold keeps the rise b."""
    moved = vector.copy()
    moved[k] = place
    low, high = free.index("shrinkage_min"), free.index("shrinkage_max")
    if low is not None and high is not None:
        if k == high:
            moved[low] = min(moved[low], place)
        else:
            moved[high] = max(moved[high], moved[low])
    if free.names[k] == "exposure_fwhm_z_um" and (threshold := free.index("threshold")) is not None:
        moved[threshold] = np.clip(
            ndtr(ndtri(vector[threshold]) * vector[k] / place), free.low[threshold], free.high[threshold]
        )
    return dict(zip(free.names, moved, strict=True))
