"""The paper's way down: the simplex of Nelder and Mead, with bounds and restarts."""

from __future__ import annotations

import numpy as np
from scipy.optimize import minimize

from dlwpredict.calibrate.problem import Point, Problem

TOLERANCE = 1e-4
"""A run ends when all corners agree to this in rmse (µm) and in every parameter (units of its start value, or of its
range where that is larger): the defaults of MATLAB's fminsearch, since the paper states no rule."""

EVALUATIONS_PER_PARAMETER = 200
"""Most predictions per run and parameter, as in fminsearch."""

MOST_RUNS = 4
"""Runs from the best point so far; the next one starts only if the last one gained more than `TOLERANCE` in rmse."""


def simplex(problem: Problem, start: Point) -> Point:
    """Minimise the loss by the Downhill Simplex from a start; restart it until nothing is gained any more."""
    best = start
    for _ in range(MOST_RUNS):
        before, best = best, _run(problem, best)
        if _rms(problem, before) - _rms(problem, best) < TOLERANCE:
            break
    return best


def _run(problem: Problem, start: Point) -> Point:
    """Return the best point of one run; corners lie 5 % off the start, inside the bounds."""
    free = problem.free
    unit = np.maximum(np.abs(start.vector), 0.01 * (free.high - free.low))
    best = start

    def cost(scaled: np.ndarray) -> float:
        nonlocal best
        vector = scaled * unit
        inside = free.allowed(vector)
        point = problem.at(inside, best)
        if point.cost < best.cost:
            best = point
        return _rms(problem, point) + float(np.abs((inside - vector) / unit).sum())

    corners = [start.vector / unit]
    for k in range(len(unit)):
        up = start.vector + 0.05 * unit * np.eye(len(unit))[k]
        down = start.vector - 0.05 * unit * np.eye(len(unit))[k]
        corners.append((up if np.array_equal(free.allowed(up), up) else free.allowed(down)) / unit)
    minimize(
        cost,
        corners[0],
        method="Nelder-Mead",
        bounds=list(zip(free.low / unit, free.high / unit, strict=True)),
        options={
            "initial_simplex": np.array(corners),
            "xatol": TOLERANCE,
            "fatol": TOLERANCE,
            "maxfev": EVALUATIONS_PER_PARAMETER * len(unit),
        },
    )
    return best


def _rms(problem: Problem, point: Point) -> float:
    return float(np.sqrt(point.cost / sum(r.points for r in problem.recordings)))
