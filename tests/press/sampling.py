"""Reading a map between its pixels, without overshoot at cliffs."""

from itertools import pairwise

import numpy as np
from scipy.ndimage import (
    convolve1d,
    map_coordinates,
    maximum_filter,
    minimum_filter,
    minimum_filter1d,
    spline_filter,
)

RIM = 12  # pixels of substrate put around the map, so that the spline ends in flat ground
ROOM = 0.2


def _room(heights):
    """Return how far a smooth valley may reach below its pixels."""
    room = np.zeros_like(heights)
    for axis in (0, 1):
        bend = convolve1d(heights, [1.0, -2.0, 1.0], axis=axis, mode="nearest")
        room += ROOM * np.maximum(minimum_filter1d(bend, 3, axis=axis), 0)
    return room


class Surface:
    """A height map (rows upwards, substrate all round) that can be read at any point.

    A cubic spline, held between the lowest and the highest of the nine nearest pixels, so that cliffs do not ring.
    Where the second differences of three neighbours have one sign, as on the top of a wave, there is more room by
    `ROOM` times the smallest of them (a parabola needs 1/8 for each axis).
    """

    def __init__(self, heights, grid):
        self.grid = grid
        padded = np.pad(np.asarray(heights, float), RIM)
        self.spline = spline_filter(padded, order=3, mode="nearest")
        self.low = minimum_filter(padded, 3) - _room(padded)
        self.high = maximum_filter(padded, 3) + _room(-padded)

    def at(self, x, y):
        """Return the heights at points in um from the map's centre."""
        column = (x - self.grid.x[0]) / self.grid.dx + RIM
        row = (y - self.grid.y[0]) / self.grid.dy + RIM
        value = map_coordinates(self.spline, [row, column], order=3, mode="nearest", prefilter=False)
        near = tuple(
            np.clip(np.rint(place).astype(int), 0, count - 1)
            for place, count in zip((row, column), self.spline.shape, strict=True)
        )
        return np.clip(value, self.low[near], self.high[near])


def covered(surface, came_from, tallest, levels=48):
    """Return the highest z at which each point is covered, linear between levels.

    `came_from(z)` gives the coordinates (x, y) in um where the cross-section now seen at height z lay before.
    """
    heights = np.linspace(0, 1.02 * tallest + 0.05, levels)
    below = surface.at(*came_from(heights[0]))
    out = np.zeros_like(below)
    for low, high in pairwise(heights):
        above = surface.at(*came_from(high)) - high
        crossing = (below > 0) & (above <= 0)
        share = np.divide(below, below - above, out=np.zeros_like(below), where=crossing)
        out = np.where(crossing, low + share * (high - low), out)
        below = above
    return out
