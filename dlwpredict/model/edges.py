"""Pixels that the edge of the exposed resin runs through: how much of them is exposed.

A wall is a jump of the height, but exposure is continuous across it. A column that is all or nothing, as its centre is,
lets a wall jump by a whole pixel where a parameter moves it by a nanometre, and cross-linking carries that over the
part: 30 nm rms at pixels of 0.5 µm. The share of the pixel that is exposed moves with the wall.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from dlwpredict.numerics.smoothing import FAINT, ndtri

PARTS = 4
"""Parts of a level in which the distance from the edge is linear."""

_T = np.linspace(0, 1, PARTS + 1)
_CUBIC = np.stack(
    [
        -_T * (_T - 1) * (_T - 2) / 6,
        (_T + 1) * (_T - 1) * (_T - 2) / 2,
        -(_T + 1) * _T * (_T - 2) / 2,
        (_T + 1) * _T * (_T - 1) / 6,
    ],
    axis=1,
).astype(np.float32)  # Lagrange's, through values at −1, 0, 1 and 2

_LEAST = 1e-4  # share of the dose: what single precision tells from 0 and 1 in Φ⁻¹, to 1e-3
_FAR = 30.0  # pixels: no edge is near, and single precision keeps the share
_EVEN = 1e-3  # of a pixel: where an edge runs as straight up as this, its two ends are as good as one place


class Level(NamedTuple):
    """Exposure, threshold and which pixels' centres are exposed on one level of a tile, shape (rows, cols) each.

    The threshold is (1, 1) where it is the same everywhere.
    """

    exposure: np.ndarray
    threshold: np.ndarray
    exposed: np.ndarray


def taken(plane: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Return a plane at flat places, one value where it has but one."""
    return plane.take(places) if plane.size > 1 else plane.ravel()


def near_steps(heights_um: np.ndarray, least_um: Sequence[float], reach_px: Sequence[float]) -> np.ndarray:
    """Return how much a pixel counts as near to a step of the heights or the rim of what is written, 0 to 1.

    All as far as the reach from the step, less by one per pixel beyond: what hangs on it is continuous in the reach.

    Parameters
    ----------
    heights_um : numpy.ndarray, shape (rows, cols)
    least_um, reach_px : pair of float
        Of a step along y and along x.

    Examples
    --------
    >>> near_steps(np.array([[0.0, 0, 0, 3, 3.1, 3.2, 3.3]]), (1.0, 1.0), (0.5, 0.5))
    array([[0. , 0.5, 1. , 1. , 0.5, 0. , 0. ]])
    """
    near = np.zeros(heights_um.shape)
    for axis, least in enumerate(least_um):
        lines, marks = np.moveaxis(heights_um, axis, 0), np.moveaxis(near, axis, 0)
        steps = (np.abs(np.diff(lines, axis=0)) > least) | np.diff(lines > 0, axis=0)
        marks[1:][steps] = marks[:-1][steps] = 1
    for axis, reach in enumerate(reach_px):
        marks, seeds = np.moveaxis(near, axis, 0), np.moveaxis(near.copy(), axis, 0)
        for k in range(1, min(int(np.ceil(reach)) + 1, len(marks))):
            share = min(1 + reach - k, 1)
            np.maximum(marks[k:], np.minimum(seeds[:-k], share), out=marks[k:])
            np.maximum(marks[:-k], np.minimum(seeds[k:], share), out=marks[:-k])
    return near


class Edges:
    """Columns of a tile near walls: what their exposed share adds to the height of their centres.

    With u the distance of a pixel's centre from the edge, in pixels, the exposed share of the pixel is clip(½ + u, 0,
    1): a straight edge reconstructed in each cell (Youngs, in Morton & Baines, Numerical Methods for Fluid Dynamics,
    1982). Where the surface is no wall nothing is added: what one half of the pixel has more, the other has less.
    Between levels u follows from cubics through four of them, at `PARTS` places per level and linearly between those.

    Parameters
    ----------
    near : numpy.ndarray, shape (rows, cols)
        How far it counts that an edge may run through a pixel.
    dose : numpy.ndarray, shape (rows, cols) or (1, 1)
        Largest that the exposure can reach.
    """

    def __init__(self, near: np.ndarray, dose: np.ndarray) -> None:
        self.places = np.flatnonzero(near)
        self.share = near.take(self.places)
        row, col = np.divmod(self.places, near.shape[1])
        moves = (0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)
        ends = near.shape[0] - 1, near.shape[1] - 1
        pixels = [np.clip(row + i, 0, ends[0]) * near.shape[1] + np.clip(col + j, 0, ends[1]) for i, j in moves]
        self.pixels, neighbours = np.unique(pixels, return_inverse=True)
        self.neighbours = neighbours.reshape(len(moves), -1)
        self.dose = taken(dose, self.pixels)
        self.steps = np.zeros(len(self.places))
        self.around: list[np.ndarray] = []

    def rise(self, index: int, level: Level) -> None:
        """Go on to a level, index steps high: take in what lies between the two before it, or down to the glass."""
        if not len(self.places):
            return
        inside = self.inside(level)
        if not self.around:  # below the first level all is as there
            self.around = [inside]
            distance = _quotient(inside)
            self.steps += max(index, 0) * (np.clip(0.5 + distance, 0, 1) - (distance > 0))
        self.around = [*self.around[-3:], inside]
        if len(self.around) == 4 and index >= 2:
            below, above = (np.abs(_quotient(one)) for one in self.around[1:3])
            some = np.flatnonzero(np.minimum(below, above) < 1)
            at = np.tensordot(_CUBIC, np.stack([one[:, some] for one in self.around]), 1)
            distance = _quotient(at.swapaxes(0, 1))
            ends = distance[:-1], distance[1:]
            self.steps[some] += (mean_share(*ends) - centre_share(*ends)).mean(axis=0)

    def inside(self, level: Level) -> np.ndarray:
        """Return how far exposure at some pixels' centres is above the threshold, and what it changes by per pixel.

        Both as Φ⁻¹(E/D), which is linear in the distance from a straight wall. A pixel seen along the gradient g is as
        wide as a box of the same variance, √((g_x·dx)² + (g_y·dy)²); slopes are means of the sizes of those to both
        neighbours, so that a ridge has one, too. Shape (2, pixels).
        """
        of_dose = (taken(plane, self.pixels) / self.dose for plane in (level.exposure, level.threshold))
        shares = [np.minimum(np.maximum(share, _LEAST), 1 - _LEAST) for share in of_dose]
        exposure, threshold = (ndtri(share / (1 - share)) for share in shares)
        here, below, above, right, left = (exposure - threshold).take(self.neighbours)
        down, up, east, west = (np.abs(other - here) for other in (below, above, right, left))
        here = np.where(level.exposed.take(self.places), np.maximum(here, FAINT), np.minimum(here, -FAINT))
        return np.stack([here, np.sqrt((down + up) ** 2 + (east + west) ** 2) / 2])


def _quotient(inside: np.ndarray) -> np.ndarray:
    """Return the distance from the edge in pixels, `_FAR` where none is near, given the two parts of it."""
    above, across = inside
    return np.clip(above / np.maximum(across, FAINT), -_FAR, _FAR)


def mean_share(lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Return the mean of clip(½ + u, 0, 1) over u between two ends.

    Examples
    --------
    >>> mean_share(np.array([0.0, 0.5, 2.0, 0.25]), np.array([0.0, -0.5, -2.0, 0.75])).tolist()
    [0.5, 0.5, 0.5, 0.9375]
    """
    apart = upper - lower
    even = np.abs(apart) < _EVEN
    between = (_integral(upper) - _integral(lower)) / np.where(even, 1, apart)
    return np.where(even, np.minimum(np.maximum(0.5 + (lower + upper) / 2, 0), 1), between)


def _integral(u: np.ndarray) -> np.ndarray:
    """Return the integral of clip(½ + u, 0, 1) up to u."""
    return np.minimum(np.maximum(u + 0.5, 0), 1) ** 2 / 2 + np.maximum(u - 0.5, 0)


def centre_share(lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Return the share of u > 0 between two ends.

    Examples
    --------
    >>> centre_share(np.array([1.0, 1.0, -1.0]), np.array([0.5, -3.0, -2.0])).tolist()
    [1.0, 0.25, 0.0]
    """
    crosses = (lower > 0) != (upper > 0)
    positive = np.maximum(lower, 0) - np.maximum(upper, 0)
    return np.where(crosses, positive / np.where(crosses, lower - upper, 1), lower > 0)
