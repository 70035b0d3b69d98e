"""Slopes of a map with rows upwards."""

import numpy as np


def gradient(heights, grid):
    """Return (dt/dx, dt/dy) by central differences."""
    up, across = np.gradient(heights, grid.dy, grid.dx)
    return across, up


def slope(heights, grid):
    """Return the steepness |grad t|."""
    return np.hypot(*gradient(heights, grid))
