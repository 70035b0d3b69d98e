"""Our way down: bounded least squares from several starts, first on coarse pixels, last on those of the recording."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dlwpredict.calibrate.descend import descend
from dlwpredict.calibrate.problem import Point, Problem
from dlwpredict.calibrate.recordings import coarser
from dlwpredict.calibrate.straight import bent, straight

STARTS = 3
"""Places to start from on the coarsest pixels: the given one, and seeded ones about it."""

SPREAD = 0.3
"""Standard deviation of a seeded start, in units of the value, about the given one."""

COARSE_UM = 1.0
"""Coarse pixels are at most this wide ..."""
FEWEST_PX = 40
"""... and leave the smallest map at least this many pixels a side."""

GAIN = 3e-5
"""The descent ends when a fresh Jacobian promises less than this share of the cost; on coarse pixels 1e-3."""


def fast(problem: Problem, start: Point, *, seed: int = 0, gain: float = GAIN) -> Point:
    """Minimise the loss from a start.

    Parameters
    ----------
    problem : Problem
        At full resolution; its `work` counts what the coarse pixels cost too.
    start : Point
    seed : int
        Of the further starts.
    gain : float
        Share of the cost below which the last descent stops.
    """
    vector = None
    for factor in _factors(problem):
        coarse = replace(
            problem, recordings=tuple(coarser(r, factor) for r in problem.recordings), work=0.0, watch=None
        )
        if vector is None:
            places = [coarse.at(place) for place in _starts(problem, start.vector, seed)]
            found = min((descend(coarse, p, gain=1e-2, iterations=4) for p in places), key=lambda place: place.cost)
            vector = refocused(problem, descend(coarse, found, gain=1e-3, iterations=8).vector, start.vector)
        else:
            vector = descend(coarse, coarse.at(vector), gain=1e-3, iterations=8).vector
        problem.work += coarse.work
    best = start if vector is None else min(start, problem.at(vector), key=lambda place: place.cost)
    return descend(problem, best, gain=gain, iterations=40)


def refocused(problem: Problem, vector: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Return the vector with the focus of the start; the rise of flat tops is kept.

    The coarsest pixels do not resolve the focus: what they make of it may lie in another valley.
    """
    focus = [k for k, name in enumerate(problem.free.names) if name.startswith("exposure_fwhm")]
    if np.array_equal(vector[focus], start[focus]):
        return vector
    coordinates = straight(problem.free, vector)
    coordinates[focus] = start[focus]
    return bent(problem.free, coordinates)


def _factors(problem: Problem) -> list[int]:
    """Return how many pixels to average, coarsest first; none where the recording itself is coarse."""
    pitch = max(max(r.target.dx_um, r.target.dy_um) for r in problem.recordings)
    side = min(min(r.target.shape) for r in problem.recordings)
    factors, factor = [], 2
    while factor * pitch <= COARSE_UM and side / factor >= FEWEST_PX:
        factors.insert(0, factor)
        factor *= 2
    return factors


def _starts(problem: Problem, vector: np.ndarray, seed: int) -> list[np.ndarray]:
    rng = np.random.default_rng(seed)
    unit = np.maximum(np.abs(vector), 0.01 * (problem.free.high - problem.free.low))
    drawn = [vector + SPREAD * unit * rng.standard_normal(len(vector)) for _ in range(STARTS - 1)]
    return [vector, *(problem.free.allowed(place) for place in drawn)]
