"""Reading a plane between its pixels, from the nearest of them alone."""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy import ndimage

SMOOTH = 0.02
"""Share of the rise from corner to corner of four pixels by which a quintic may differ from a cubic on a surface that
pixels resolve."""

DIFFERENCES = {4: np.array([-1, 0, 1]) / 2, 6: np.array([1, -8, 0, 8, -1]) / 12}
"""Slope per pixel by central differences of second and of fourth order."""


def read_locally(plane: np.ndarray, place: np.ndarray, pixels: int = 4) -> np.ndarray:
    """Read a plane by cubics from pixel to pixel, whose slopes there are central differences.

    Only the nearest pixels along each axis count: four, exact for parabolas (cubic convolution: Keys, IEEE Trans. ASSP
    29, 1153, 1981; a = −½), or six, exact for cubics, and ten times nearer on waves of eight pixels. A spline is more
    exact on waves of few pixels, but rings several pixels deep where the surface bends from one pixel to the next, as
    it does at the rim of a part.

    Parameters
    ----------
    plane : numpy.ndarray, shape (rows, cols)
        Goes on at its rim as it ends there.
    place : numpy.ndarray, shape (2, ...)
        Rows and columns, as numbers with fractions.
    pixels : {4, 6}

    Examples
    --------
    >>> parabola = np.arange(8.0) ** 2 + np.zeros((8, 1))
    >>> read_locally(parabola, np.array([[3.0, 3.5], [2.5, 4.0]])).tolist()
    [6.25, 16.0]
    """
    (rows, up), (cols, across) = (_taps(*along, DIFFERENCES[pixels]) for along in zip(place, plane.shape, strict=True))
    return _weighted(plane, rows, up, cols, across)


def moved_along(maps: np.ndarray, by_px: float | np.ndarray, axis: int) -> tuple[np.ndarray, np.ndarray]:
    """Move maps along an axis by any number of pixels, and differentiate what was moved by that number, exactly.

    By the six-pixel cubics of `read_locally`: f(i − by) and −f′(i − by), both continuous in `by`.

    Parameters
    ----------
    maps : numpy.ndarray
        Go on at their rim as they end there.
    by_px : float or numpy.ndarray, shape (pixels along the axis,)
        One for all is faster.
    axis : int

    Examples
    --------
    >>> cubic = np.arange(20.0) ** 3
    >>> moved, by_shift = moved_along(cubic, 1.5, 0)
    >>> round(float(moved[10]), 9), round(float(by_shift[10]), 9)
    (614.125, -216.75)
    """
    if np.ndim(by_px):
        return _read_along(maps, np.arange(maps.shape[axis]) - by_px, axis)
    first = int(np.floor(-by_px))
    weights, slopes = (_cubics(np.array(-by_px - first), DIFFERENCES[6], order) for order in (0, 1))
    pixels = np.arange(-2, 4) + first
    reach = int(np.abs(pixels).max())
    kernels = np.zeros((2, 2 * reach + 1))
    kernels[:, pixels + reach] = weights, -slopes
    moved, by_shift = (ndimage.correlate1d(maps, kernel, axis=axis, mode="nearest") for kernel in kernels)
    return moved, by_shift


def _read_along(maps: np.ndarray, place: np.ndarray, axis: int) -> tuple[np.ndarray, np.ndarray]:
    """Read maps at places along an axis, in pixels; return that and minus the slopes there."""
    tables = [_taps(place, len(place), DIFFERENCES[6], order) for order in (0, 1)]
    along = np.ones(maps.ndim, int)
    along[axis] = len(place)
    read, back = np.zeros(maps.shape), np.zeros(maps.shape)
    for pixels, weights, slopes in zip(*tables[0], tables[1][1], strict=True):
        there = maps.take(pixels, axis=axis)
        read += weights.reshape(along) * there
        back -= slopes.reshape(along) * there
    return read, back


def read_means(plane: np.ndarray, place: np.ndarray, width_px: tuple[float, float]) -> np.ndarray:
    """Read means over rectangles from a plane whose values are means over its pixels.

    Along each axis, the polynomial that has the means of the nearest pixels is averaged over the rectangle, wider or
    narrower than a pixel (the reconstruction of finite volumes: Colella & Woodward, J. Comput. Phys. 54, 174, 1984,
    Eq. 1.6): of four pixels, exact for cubics; of six, exact for quintics, where both agree to `SMOOTH` of what the
    surface rises between the corners of the four. Beside a wall they do not: then only four count, and a wall leaves
    no trace beyond two pixels.

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
    four, six = (
        [_mean_taps(line, n, width, count) for line, n, width in zip(place, plane.shape, width_px, strict=True)]
        for count in (4, 6)
    )
    near, far = (_weighted(plane, *rows, *cols) for rows, cols in (four, six))
    (rows, _), (cols, _) = four
    corners = [plane[rows[i], cols[j]] for i in (0, -1) for j in (0, -1)]
    rise = np.max(corners, axis=0) - np.min(corners, axis=0)
    return np.where(np.abs(far - near) <= SMOOTH * rise, far, near)


def _weighted(plane: np.ndarray, rows: np.ndarray, up: np.ndarray, cols: np.ndarray, across: np.ndarray) -> np.ndarray:
    """Return the sums of pixels with weights along both axes."""
    flat, below = plane.ravel(), rows * plane.shape[1]
    return sum(
        a * sum(b * flat.take(row + col) for col, b in zip(cols, across, strict=True))
        for row, a in zip(below, up, strict=True)
    )


def _mean_of_powers(centre: np.ndarray, width: float, count: int) -> np.ndarray:
    """Return the means of 1, t, …, t^(count − 1) over an interval about each centre, shape (count, ...)."""
    powers = np.arange(1, count + 1)
    ends = (centre + side * width / 2 for side in (1, -1))
    high, low = (np.stack([end**power for power in powers]) for end in ends)
    return (high - low) / width / powers.reshape(-1, *[1] * np.ndim(centre))


@cache
def _nearest(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the places of the nearest pixels, t = 0 among them, and what makes a polynomial of their means."""
    places = np.arange(count) - (count // 2 - 1.0)
    return places, np.linalg.inv(_mean_of_powers(places, 1.0, count).T)


def _mean_taps(place: np.ndarray, n: int, width: float, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the nearest pixels along one axis and their weights in a mean, shape (count, ...) each."""
    places, from_means = _nearest(count)
    first = np.floor(place).astype(int)
    weights = np.tensordot(from_means.T, _mean_of_powers(place - first, width, count), axes=1)
    return np.clip(np.add.outer(places.astype(int), first), 0, n - 1), weights


def _taps(place: np.ndarray, count: int, difference: np.ndarray, order: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return the nearest pixels along one axis and their weights in the value or slope there, (pixels, ...) each."""
    first, reach = np.floor(place).astype(int), len(difference) // 2
    weights = _cubics(place - first, difference, order)
    return np.clip(np.add.outer(np.arange(-reach, reach + 2), first), 0, count - 1), weights


def _cubics(t: np.ndarray, difference: np.ndarray, order: int = 0) -> np.ndarray:
    """Return the weights of the nearest pixels at t, 0 to 1 from one to the next, or their derivatives by t."""
    reach, back = len(difference) // 2, 1 - t
    if order == 0:
        there = t * t * (3 - 2 * t)
        ends, slopes = (1 - there, there), (t * back * back, -t * t * back)
    else:
        there = 6 * t * back
        ends, slopes = (-there, there), (back * (1 - 3 * t), t * (3 * t - 2))
    weights = np.zeros((2 * reach + 2, *t.shape))
    weights[reach : reach + 2] = ends
    for end, slope in enumerate(slopes):
        for row, share in enumerate(difference, start=end):
            if share:
                weights[row] += share * slope
    return weights
