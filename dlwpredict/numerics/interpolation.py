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
    return _weighted(plane, rows, up, cols, across)


def read_means(plane: np.ndarray, place: np.ndarray, width_px: tuple[float, float]) -> np.ndarray:
    """Read means over rectangles from a plane whose values are means over its pixels.

    Along each axis, the cubic that has the means of the four nearest pixels is averaged over the rectangle (the
    reconstruction of finite volumes: Colella & Woodward, J. Comput. Phys. 54, 174, 1984, Eq. 1.6, on four cells): exact
    for cubics, whether the rectangle is wider than a pixel or narrower.

    Parameters
    ----------
    plane : numpy.ndarray, shape (rows, cols)
        Goes on at its rim as it ends there.
    place : numpy.ndarray, shape (2, ...)
        Rows and columns of the rectangles' centres, as numbers with fractions.
    width_px : (float, float)
        Sides of the rectangles along rows and columns, at most two pixels.

    Examples
    --------
    >>> squares = (np.arange(8.0) ** 2 + 1 / 12) + np.zeros((8, 1))  # means of x² over pixels
    >>> read_means(squares, np.array([[3.0, 3.5], [2.5, 4.0]]), (1.0, 2.0)).round(9).tolist()
    [6.583333333, 16.333333333]
    """
    sides = zip(place, plane.shape, width_px, strict=True)
    (rows, up), (cols, across) = (_mean_taps(line, count, width) for line, count, width in sides)
    return _weighted(plane, rows, up, cols, across)


def _weighted(plane: np.ndarray, rows: np.ndarray, up: np.ndarray, cols: np.ndarray, across: np.ndarray) -> np.ndarray:
    """Return the sums of pixels with weights along both axes."""
    flat, below = plane.ravel(), rows * plane.shape[1]
    return sum(
        a * sum(b * flat.take(row + col) for col, b in zip(cols, across, strict=True))
        for row, a in zip(below, up, strict=True)
    )


FOUR, POWERS = np.arange(-1.0, 3.0), np.arange(1, 5)
"""The four nearest pixels, from that at or before a place; and the powers of the primitive of a cubic."""


def _mean_of_powers(centre: np.ndarray, width: float) -> np.ndarray:
    """Return the means of 1, t, t², t³ over an interval about each centre, shape (4, ...)."""
    ends = (centre + side * width / 2 for side in (1, -1))
    high, low = (np.stack([end**power for power in POWERS]) for end in ends)
    return (high - low) / width / POWERS.reshape(-1, *[1] * np.ndim(centre))


FROM_MEANS = np.linalg.inv(_mean_of_powers(FOUR, 1.0).T)
"""From the means over four pixels to the coefficients of the cubic that has them."""


def _mean_taps(place: np.ndarray, count: int, width: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the four nearest pixels along one axis and their weights in a mean, shape (4, ...) each."""
    first = np.floor(place).astype(int)
    weights = np.tensordot(FROM_MEANS.T, _mean_of_powers(place - first, width), axes=1)
    return np.clip(np.add.outer(FOUR.astype(int), first), 0, count - 1), weights


def _taps(place: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the four nearest pixels along one axis and their weights, shape (4, ...) each."""
    first = np.floor(place).astype(int)
    t = place - first
    weights = [t * (t * (2 - t) - 1), t * t * (3 * t - 5) + 2, t * (t * (4 - 3 * t) + 1), t * t * (t - 1)]
    return np.clip(np.add.outer(np.arange(-1, 3), first), 0, count - 1), np.stack(weights) / 2
