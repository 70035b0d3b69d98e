"""Reading a plane between its pixels, from the nearest of them alone."""

from __future__ import annotations

import numpy as np


def read_locally(plane: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Read a plane by cubic convolution (Keys, IEEE Trans. ASSP 29, 1153, 1981; a = −½): exact for parabolas.

    Only the four nearest pixels along each axis count. A spline is more exact on waves of few pixels, but rings several
    pixels deep where the surface bends from one pixel to the next, as it does at the rim of a part.

    Parameters
    ----------
    plane : numpy.ndarray, shape (rows, cols)
        Goes on at its rim as it ends there.
    place : numpy.ndarray, shape (2, ...)
        Rows and columns, as numbers with fractions.

    Examples
    --------
    >>> parabola = np.arange(8.0) ** 2 + np.zeros((8, 1))
    >>> read_locally(parabola, np.array([[3.0, 3.5], [2.5, 4.0]])).tolist()
    [6.25, 16.0]
    """
    (rows, up), (cols, across) = (_taps(line, count) for line, count in zip(place, plane.shape, strict=True))
    flat, below = plane.ravel(), rows * plane.shape[1]
    return sum(
        a * sum(b * flat.take(row + col) for col, b in zip(cols, across, strict=True))
        for row, a in zip(below, up, strict=True)
    )


def _taps(place: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the four nearest pixels along one axis and their weights, shape (4, ...) each."""
    first = np.floor(place).astype(int)
    t = place - first
    weights = [t * (t * (2 - t) - 1), t * t * (3 * t - 5) + 2, t * (t * (4 - 3 * t) + 1), t * t * (t - 1)]
    return np.clip(np.add.outer(np.arange(-1, 3), first), 0, count - 1), np.stack(weights) / 2
