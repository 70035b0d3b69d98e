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


def near_steps(heights_um: np.ndarray, least_um: float, reach_px: Sequence[int]) -> np.ndarray:
    """Return the pixels so near to a step of the heights, or to the rim of what is written, shape (rows, cols).

    Examples
    --------
    >>> near_steps(np.array([[0.0, 0, 0, 3, 3.1, 3.2, 3.3]]), 1.0, (2, 2)).astype(int)
    array([[0, 1, 1, 1, 1, 0, 0]])
    """
    near = np.zeros(heights_um.shape, dtype=bool)
    for axis in (0, 1):
        lines, marks = np.moveaxis(heights_um, axis, 0), np.moveaxis(near, axis, 0)
        jumps = (np.abs(np.diff(lines, axis=0)) > least_um) | (np.diff(lines > 0, axis=0))
        marks[1:] |= jumps
        marks[:-1] |= jumps
    for axis, reach in enumerate(reach_px):
        marks, seeds = np.moveaxis(near, axis, 0), np.moveaxis(near.copy(), axis, 0)
        for k in range(1, min(reach, len(marks))):
            marks[k:] |= seeds[:-k]
            marks[:-k] |= seeds[k:]
    return near


class Edges:
    """Columns of a tile near walls: what their exposed share adds to the height of their centres.

    The distance u of a pixel's centre from the edge, in pixels, is linear from level to level, and the exposed share of
    the pixel is clip(½ + u, 0, 1): a straight edge reconstructed in each cell (Youngs, in Morton & Baines, Numerical
    Methods for Fluid Dynamics, 1982). Where the surface is no wall nothing is added: what one half of the pixel has
    more, the other has less.

    Parameters
    ----------
    near : numpy.ndarray of bool, shape (rows, cols)
        Pixels that an edge may run through.
    dose : numpy.ndarray, shape (rows, cols) or (1, 1)
        Largest that the exposure can reach.
    """

    def __init__(self, near: np.ndarray, dose: np.ndarray) -> None:
        self.places = np.flatnonzero(near)
        row, col = np.divmod(self.places, near.shape[1])
        moves = (0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)
        ends = near.shape[0] - 1, near.shape[1] - 1
        pixels = [np.clip(row + i, 0, ends[0]) * near.shape[1] + np.clip(col + j, 0, ends[1]) for i, j in moves]
        self.pixels, around = np.unique(pixels, return_inverse=True)
        self.around = around.reshape(len(moves), -1)
        self.dose = taken(dose, self.pixels)
        self.steps = np.zeros(len(self.places))
        self.last: np.ndarray | None = None

    def rise(self, index: int, level: Level) -> None:
        """Go on to a level, index steps high: take in what lies between it and the one before, or the glass."""
        if not len(self.places):
            return
        inside = self.inside(level)
        if index > 0:
            lower, thick = (inside, index) if self.last is None else (self.last, 1)
            self.steps += thick * (mean_share(lower, inside) - centre_share(lower, inside))
        self.last = inside

    def inside(self, level: Level) -> np.ndarray:
        """Return how far inside the exposed resin the pixels' centres are, in widths of a pixel across the edge.

        The margin, Φ⁻¹(E/D) − Φ⁻¹(P/D), is linear in the distance from a straight wall. A pixel seen along the gradient
        g is as wide as a box of the same variance, √((g_x·dx)² + (g_y·dy)²); slopes are means of the sizes of those to
        both neighbours, so that a ridge has one, too.
        """
        of_dose = (taken(plane, self.pixels) / self.dose for plane in (level.exposure, level.threshold))
        shares = [np.minimum(np.maximum(share, _LEAST), 1 - _LEAST) for share in of_dose]
        exposure, threshold = (ndtri(share / (1 - share)) for share in shares)
        here, below, above, right, left = (exposure - threshold).take(self.around)
        down, up, east, west = (np.abs(other - here) for other in (below, above, right, left))
        across = np.sqrt((down + up) ** 2 + (east + west) ** 2) / 2
        size = np.minimum(np.abs(here) / np.maximum(across, FAINT), _FAR)
        return np.where(level.exposed.take(self.places), size, -size)


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
