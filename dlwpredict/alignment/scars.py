"""Scars: lines of a scan on which the tip had jumped, along all of the line or a long part of it."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from dlwpredict.alignment.plane import mad_sigma
from dlwpredict.alignment.spikes import spike_limit, suspected_spikes
from dlwpredict.noise.estimate import DISCREPANCY_UM

WIDEST = 2
"""Lines beside each other that a scar takes at most: what is wider is relief."""

AROUND = 5 * WIDEST
"""Lines around a line that it is compared with: the widest scar is no more than the uppermost fifth of them."""

SHORTEST_PX = 5 * WIDEST
"""Shortest part of a line that is looked at: a scar is five times as long as wide, dirt and bumps are round."""

PASSES = 2
"""The line itself, then what reading between the lines has given its neighbours of it."""


def suspected_scars(residual_um: np.ndarray, used: np.ndarray, print_um: np.ndarray, axis: int) -> np.ndarray:
    """Mark parts of lines that stand out of the lines beside them.

    It is the rule of `spikes`, for means m over parts of lines: the whole line, its halves, quarters and so on, half
    overlapping. A part is a scar where m leaves the range between the second and fourth fifth of the same part of the
    lines around by more than that range's own width plus the `spike_limit` of what all parts of this length scatter
    by. So rows that are uneven all over the map set their own limit, a step or a slope of the misfit widens its
    range and passes, and where the print itself bends from line to line by as much, |z₋₁ − 2z₀ + z₊₁|/2, misfit of the
    print may do the same. The height must be known on either side: a misfit that dies away from a wall is no scar.
    Lone spikes do not enter the means.

    Parameters
    ----------
    residual_um : numpy.ndarray, shape (rows, cols)
        Recording − prediction.
    used : numpy.ndarray of bool, shape (rows, cols)
        Points that count.
    print_um : numpy.ndarray, shape (rows, cols)
        The prediction.
    axis : int
        0 where lines of the scan are rows, 1 where they are columns.

    Returns
    -------
    numpy.ndarray of bool, shape (rows, cols)

    Examples
    --------
    >>> heights = 0.01 * np.random.default_rng(0).standard_normal((40, 60))
    >>> heights[20, 30:] += 0.1
    >>> flat, known = np.zeros((40, 60)), np.ones((40, 60), dtype=bool)
    >>> suspected_scars(heights, known, flat, axis=0).sum(axis=1).nonzero()[0].tolist()
    [20]
    """
    residual, known, surface = (values if axis == 0 else values.T for values in (residual_um, used, print_um))
    bends, scars = _bends(surface), np.zeros(known.shape, dtype=bool)
    lone = _lone(suspected_spikes(residual, known))
    for _ in range(PASSES):
        scars |= known & _standing_out(residual, known, bends, lone | scars)
    return scars if axis == 0 else scars.T


def _standing_out(residual: np.ndarray, known: np.ndarray, bends: np.ndarray, left_out: np.ndarray) -> np.ndarray:
    """Return the parts of lines that stand out of those around; all of shape (lines, points)."""
    count = known.shape[1]
    lengths = [count >> k for k in range(count.bit_length()) if count >> k >= SHORTEST_PX]
    parts = [(np.linspace(0, count - n, 2 * (count // n) - 1).astype(int), n) for n in lengths]
    means = [_means(residual, known & ~left_out, *part) for part in parts]
    limit = spike_limit(sum(int(np.isfinite(mean).sum()) for mean in means))
    found = np.zeros(known.shape, dtype=bool)
    for mean, part in zip(means, parts, strict=True):
        bent = _means(bends, known, *part)
        framed = ndimage.minimum_filter1d(np.isfinite(bent), 2 * WIDEST + 1, axis=0, mode="constant", cval=0)
        beyond, apart = (np.where(framed, values, np.nan) for values in _compared(mean))
        noise = max(mad_sigma(apart[np.isfinite(apart)]), DISCREPANCY_UM)
        out = (beyond > limit * noise) & (np.abs(apart) > bent)
        for line, k in np.argwhere(out):
            found[line, part[0][k] : part[0][k] + part[1]] = True
    return found


def _lone(spikes: np.ndarray) -> np.ndarray:
    """Return the spikes that are less than half of the points of their line around them: more of them are a scar."""
    return spikes & (ndimage.uniform_filter1d(spikes.astype(float), SHORTEST_PX, axis=1, mode="nearest") < 0.5)


def _sums(values: np.ndarray, begins: np.ndarray, length: int) -> np.ndarray:
    """Return the sums over parts of lines, shape (lines, parts)."""
    running = np.pad(np.cumsum(values, axis=1, dtype=float), ((0, 0), (1, 0)))
    return running[:, begins + length] - running[:, begins]


def _means(values: np.ndarray, known: np.ndarray, begins: np.ndarray, length: int) -> np.ndarray:
    """Return the means over parts of lines, shape (lines, parts); NaN where less than half is known."""
    points = _sums(known, begins, length)
    means = _sums(np.where(known, values, 0.0), begins, length) / np.maximum(points, 1)
    return np.where(2 * points >= length, means, np.nan)


def _compared(means: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return how far means leave the range of those around by more than its width, and how far their median.

    Both of shape (lines, parts), NaN where the mean is.
    """
    half = AROUND // 2
    padded = np.pad(means, ((half, half), (0, 0)), constant_values=np.nan)
    around = np.sort(np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1, axis=0), axis=-1)  # NaN come last
    count = np.isfinite(around).sum(axis=-1)

    def ranked(rank: np.ndarray) -> np.ndarray:
        return np.take_along_axis(around, np.maximum(rank, 0)[..., None], axis=-1)[..., 0]

    low, high = ranked(count // 5), ranked(count - 1 - count // 5)
    middle = (ranked((count - 1) // 2) + ranked(count // 2)) / 2
    return np.maximum(means - high, low - means) - (high - low), means - middle


def _bends(surface: np.ndarray) -> np.ndarray:
    """Return how much a surface bends from line to line, at a point or as near to it as a scar is wide, µm."""
    second = np.zeros(surface.shape)
    second[1:-1] = np.abs(surface[:-2] - 2 * surface[1:-1] + surface[2:]) / 2
    return ndimage.maximum_filter1d(np.nan_to_num(second), 2 * WIDEST + 1, axis=0)
