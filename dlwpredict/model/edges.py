"""Pixels that the edge of the exposed resin runs through: how much of them is exposed.

A wall is a jump of the height, but exposure is continuous across it. A column that is all or nothing, as its centre is,
lets a wall jump by a whole pixel where a parameter moves it by a nanometre, and cross-linking carries that over the
part: 30 nm rms at pixels of 0.5 µm. The share of the pixel that is exposed moves with the wall.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dlwpredict.numerics.normal import ndtri_of_odds
from dlwpredict.numerics.smoothing import FAINT

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
        self.above: list[np.ndarray] = []
        self.across: list[np.ndarray] = []

    def rise(self, exposures: np.ndarray, thresholds: np.ndarray, exposed: np.ndarray) -> None:
        """Go on to some higher levels, (levels, rows, cols): how much above the threshold exposure is, and how steep.

        Both as Φ⁻¹(E/D), which is linear in the distance from a straight wall. A pixel seen along the gradient g is as
        wide as a box of the same variance, √((g_x·dx)² + (g_y·dy)²); slopes are means of the sizes of those to both
        neighbours, so that a ridge has one, too.
        """
        planes = (np.stack([taken(plane, self.pixels) for plane in levels]) for levels in (exposures, thresholds))
        shares = [np.minimum(np.maximum(plane / self.dose, _LEAST), 1 - _LEAST) for plane in planes]
        exposure, threshold = (ndtri_of_odds(share / (1 - share)) for share in shares)
        here, *around = np.moveaxis((exposure - threshold)[:, self.neighbours], 1, 0)
        down, up, east, west = (np.abs(other - here) for other in around)
        inside = exposed.reshape(len(exposed), -1)[:, self.places]
        self.above.append(np.where(inside, np.maximum(here, FAINT), np.minimum(here, -FAINT)))
        self.across.append(np.sqrt((down + up) ** 2 + (east + west) ** 2) / 2)

    def steps(self, first: int) -> np.ndarray:
        """Return what shares add to the heights of centres, in steps of the levels; the lowest level is the first."""
        # below the first level all is as there
        above, across = (np.concatenate([planes[0][:1], *planes]) for planes in (self.above, self.across))
        distance = _distance(above, across)
        total = max(first, 0) * (np.clip(0.5 + distance[0], 0, 1) - (distance[0] > 0))
        near = np.minimum(np.abs(distance[1:-2]), np.abs(distance[2:-1])) < 1
        near[: max(-first, 0)] = False
        level, place = np.nonzero(near)
        four = (np.stack([planes[level + k, place] for k in range(4)]) for planes in (above, across))
        between = _distance(*(_CUBIC @ values for values in four))
        ends = between[:-1], between[1:]
        more = (mean_share(*ends) - centre_share(*ends)).mean(axis=0)
        return self.share * (total + np.bincount(place, more, len(self.places)))


def _distance(above: np.ndarray, across: np.ndarray) -> np.ndarray:
    """Return the distance from the edge in pixels, `_FAR` where none is near."""
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
