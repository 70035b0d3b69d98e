"""What acts in one direction only and dies away exponentially: delays, trailing means, along an axis of an array."""

from __future__ import annotations

import numpy as np
import scipy  # its parts are imported on first use: each takes longer than a small prediction, and most need none

LAG_REACH = 12.0
"""A one-sided exponential ends after this many of its lengths; what lies beyond is 6e-6."""


def lag(planes: np.ndarray, length_px: float, axis: int) -> np.ndarray:
    """Convolve one axis with k(s) = e^(−s/ℓ)/ℓ, s·ℓ > 0: a delay of mean ℓ towards higher indices where ℓ > 0.

    The recursion y_n = a·y_{n−1} + … decays as k does, a = e^(−1/ℓ); its taps on x_{n+1}, x_n, x_{n−1} give it the sum
    1, the mean ℓ and the variance ℓ² of k at every pitch. Meant for planes that are smooth over a pixel.

    Parameters
    ----------
    planes : numpy.ndarray
        Outside there is nothing.
    length_px : float
        ℓ ≠ 0 in pixels.
    axis : int

    Examples
    --------
    >>> spot = np.eye(1, 60, 20)
    >>> late = lag(spot, 1.7, axis=1)[0]
    >>> n = np.arange(60) - 20
    >>> bool(np.allclose([late.sum(), late @ n, late @ (n - 1.7) ** 2], [1, 1.7, 1.7**2]))
    True
    """
    if length_px < 0:
        return np.flip(lag(np.flip(planes, axis), -length_px, axis), axis)
    a = np.exp(-1 / length_px)
    mean = length_px - a / (1 - a)
    square = length_px**2 - a / (1 - a) ** 2 + mean**2
    taps = (1 - a) * np.array([square - mean, 2 - 2 * square, square + mean]) / 2
    lines = np.moveaxis(planes, axis, -1)
    ahead = np.concatenate([lines, np.zeros((*lines.shape[:-1], 1))], axis=-1)
    return np.moveaxis(scipy.signal.lfilter(taps, [1, -a], ahead)[..., 1:], -1, axis)


def trailing_mean(planes: np.ndarray, length_px: float, axis: int) -> np.ndarray:
    """Average what lies before each pixel's centre, with weight e^(−s/L)/L at the distance s.

    Values are constant over a pixel; the own pixel counts with its first half. Exact at every pitch, never negative,
    1 far inside ones, and nothing acts backwards.

    Parameters
    ----------
    planes : numpy.ndarray
        Outside there is nothing.
    length_px : float
        L > 0 in pixels; before = lower indices.
    axis : int

    Examples
    --------
    >>> trailing_mean(np.array([[0.0, 1.0, 1.0, 0.0]]), 2.0, axis=1).round(3).tolist()
    [[0.0, 0.221, 0.528, 0.492]]
    """
    half, whole = float(np.exp(-0.5 / length_px)), float(np.exp(-1 / length_px))
    pixels = np.ascontiguousarray(np.moveaxis(planes, axis, 0))
    ended = faded((1 - whole) * pixels, whole)
    means = (1 - half) * pixels
    means[1:] += half * ended[:-1]
    return np.ascontiguousarray(np.moveaxis(means, 0, axis))


def faded(lines: np.ndarray, kept: float | np.ndarray) -> np.ndarray:
    """Return y_n = x_n + kept_n · y_{n−1} along the first axis: all lines step together, quicker than one by one.

    Examples
    --------
    >>> faded(np.array([1.0, 0.0, 2.0]), 0.5).tolist()
    [1.0, 0.5, 2.25]
    """
    result, share = lines.copy(), np.broadcast_to(np.asarray(kept, dtype=lines.dtype), lines.shape)
    for n in range(1, len(result)):
        result[n] += share[n] * result[n - 1]
    return result
