"""Coordinates in which the model is nearly linear, so that a descent need not follow a bent valley.

Threshold P and axial width s_z of the focus act on a flat top together, as its height above the written one,
b = −s_z·Φ⁻¹(P): along a curve of constant b the prediction hardly changes. With b in the place of P that
curve is a straight line. Every other parameter is its own coordinate.
"""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr, ndtri

from dlwpredict.infer.free import Free
from dlwpredict.numerics.smoothing import FWHM_PER_SIGMA


def straight(free: Free, vector: np.ndarray) -> np.ndarray:
    """Return the coordinates of a parameter vector: the rise b (µm) where the threshold stood."""
    place = free.index("threshold")
    if place is None:
        return vector.copy()
    coordinates = vector.copy()
    coordinates[place] = -_sigma_z(free, vector) * ndtri(vector[place])
    return coordinates


def bent(free: Free, coordinates: np.ndarray) -> np.ndarray:
    """Return the parameter vector at these coordinates, brought inside the bounds."""
    place = free.index("threshold")
    if place is None:
        return free.allowed(coordinates)
    vector = free.allowed(np.where(np.arange(len(coordinates)) == place, free.low, coordinates))
    vector[place] = ndtr(-coordinates[place] / _sigma_z(free, vector))
    return free.allowed(vector)


def bending(free: Free, vector: np.ndarray) -> np.ndarray:
    """Return ∂parameters/∂coordinates, shape (parameters, parameters)."""
    matrix, place = np.eye(len(vector)), free.index("threshold")
    if place is None:
        return matrix
    sigma, normal = _sigma_z(free, vector), ndtri(vector[place])
    density = np.exp(-(normal**2) / 2) / np.sqrt(2 * np.pi)
    matrix[place, place] = -density / sigma
    width = free.index("exposure_fwhm_z_um")
    if width is not None:
        matrix[place, width] = -density * normal / sigma / FWHM_PER_SIGMA
    return matrix


def straight_bounds(free: Free, vector: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the bounds of one step: those of b hold at this vector's s_z; widths at most halve or double."""
    low, high, place = free.low.copy(), free.high.copy(), free.index("threshold")
    for k, name in enumerate(free.names):
        if name.endswith("fwhm_um") or "_fwhm_" in name:
            low[k], high[k] = (
                max(low[k], vector[k] / 2),
                min(high[k], max(2 * vector[k], low[k] + 0.1 * (high[k] - low[k]))),
            )
    if place is not None:
        sigma = _sigma_z(free, vector)
        low[place], high[place] = -sigma * ndtri(free.high[place]), -sigma * ndtri(free.low[place])
    return low, high


def _sigma_z(free: Free, vector: np.ndarray) -> float:
    width = free.index("exposure_fwhm_z_um")
    return (free.base.paper.exposure_fwhm_z_um if width is None else vector[width]) / FWHM_PER_SIGMA
