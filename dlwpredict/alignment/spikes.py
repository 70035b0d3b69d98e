"""Spikes: lone points that neither their neighbours nor the print can explain."""

from __future__ import annotations

import numpy as np
from scipy import ndimage, special

from dlwpredict.alignment.plane import mad_sigma
from dlwpredict.alignment.refine import Fit
from dlwpredict.alignment.surface import Surface
from dlwpredict.heightmap import HeightMap


def spike_limit(points: int) -> float:
    """Deviation in σ beyond which less than one of so many Gaussian points is expected to lie.

    Examples
    --------
    >>> round(spike_limit(100_000), 2)
    4.42
    """
    return float(-special.ndtri(0.5 / max(points, 10)))


def suspected_spikes(heights_um: np.ndarray, measured: np.ndarray) -> np.ndarray:
    """Mark points that stand out of their 5 × 5 neighbourhood.

    A point is suspect where it leaves the range between the neighbourhood's second and fourth fifth (20 and 80 %
    quantile) by more than that range's own width plus the `spike_limit` of the map's point noise: an edge or
    a slope widens its own neighbourhood's range and passes; blobs of up to four points are still caught.

    Parameters
    ----------
    heights_um : numpy.ndarray, shape (rows, cols)
        Heights without gaps, µm.
    measured : numpy.ndarray of bool, shape (rows, cols)

    Returns
    -------
    numpy.ndarray of bool, shape (rows, cols)
    """
    middle = ndimage.median_filter(heights_um, 3, mode="nearest")
    noise = mad_sigma((heights_um - middle)[measured])
    apart = np.abs(heights_um - middle)
    maybe = measured & (apart > 3 * noise)
    low = ndimage.percentile_filter(heights_um, 20, 5, mode="nearest")
    high = ndimage.percentile_filter(heights_um, 80, 5, mode="nearest")
    beyond = np.maximum(heights_um - high, low - heights_um)
    return maybe & (beyond > (high - low) + spike_limit(int(measured.sum())) * noise)


def confirmed_spikes(recording: HeightMap, suspects: np.ndarray, fit: Fit) -> np.ndarray:
    """Keep those suspects that the fitted print does not explain either.

    A narrow post stands out of its neighbours as a spike does, but the target says so. A suspect stays marked where
    it differs from the fitted likeness by more than the `spike_limit` of what the other points differ by. Suspects
    outside the target stay marked.

    Parameters
    ----------
    recording : HeightMap
        As recorded, turned back already if mirrored.
    suspects : numpy.ndarray of bool, shape (rows, cols)
    fit : Fit
    """
    x, y = np.meshgrid(recording.x_um, recording.y_um)
    level = fit.level
    shape = level.grid[0].shape
    likeness = Surface(fit.fitted.reshape(shape), np.ones(shape), level.pitch_um, level.pitch_um)
    regular = recording.measured & ~suspects
    step = max(1, int(np.sqrt(regular.sum() / 20_000)))
    sparse = np.zeros_like(regular)
    sparse[::step, ::step] = regular[::step, ::step]

    def misfit(points: np.ndarray) -> np.ndarray:
        heights, support = likeness.at(*fit.pose.to_target(x[points], y[points]))
        return np.where(support > 0.5, recording.heights_um[points] - heights, np.nan)

    ordinary = misfit(sparse)
    limit = spike_limit(int(regular.sum())) * mad_sigma(ordinary[~np.isnan(ordinary)])
    confirmed = suspects.copy()
    confirmed[suspects] = ~(np.abs(misfit(suspects)) <= limit)
    return confirmed
