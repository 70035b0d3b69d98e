"""Robust planes and the scale of noise."""

from __future__ import annotations

import numpy as np

TUKEY = 4.685  # 95 % efficiency on Gaussian noise (Huber & Ronchetti, Robust Statistics, 2009)


def mad_sigma(values: np.ndarray) -> float:
    """Standard deviation from the median absolute deviation, 1.4826·MAD; blind to outliers.

    Examples
    --------
    >>> mad_sigma(np.array([-1.0, 0.0, 0.0, 1.0, -1.0, 1.0, 500.0]))
    1.4826
    """
    return float(1.4826 * np.median(np.abs(values - np.median(values)))) if values.size else 0.0


def tukey_weights(residual: np.ndarray, sigma: float, cut: float = TUKEY) -> np.ndarray:
    """Tukey's biweight (1 − (r/cσ)²)² inside c·σ, 0 outside."""
    return np.clip(1 - (residual / (cut * max(sigma, 1e-12))) ** 2, 0, None) ** 2


def robust_fit(columns: np.ndarray, values: np.ndarray, *, rounds: int = 12) -> tuple[np.ndarray, np.ndarray]:
    """Linear fit by iterated Tukey weights from a least-absolute start.

    Parameters
    ----------
    columns : numpy.ndarray, shape (points, parameters)
    values : numpy.ndarray, shape (points,)

    Returns
    -------
    coefficients, weights : numpy.ndarray
        Shapes (parameters,) and (points,).
    """
    weights = np.ones(len(values))
    for turn in range(2 * rounds):
        root = np.sqrt(weights)
        coefficients = np.linalg.lstsq(columns * root[:, None], values * root, rcond=None)[0]
        residual = values - columns @ coefficients
        sigma = max(mad_sigma(residual), 1e-9)
        if turn < rounds:  # least absolute deviations: no start can be spoilt by outliers
            weights = sigma / np.maximum(np.abs(residual), 1e-3 * sigma)
        else:
            weights = tukey_weights(residual, sigma)
    return coefficients, weights


def plane_columns(x_um: np.ndarray, y_um: np.ndarray) -> np.ndarray:
    """Columns 1, x, y of a plane, shape (points, 3)."""
    return np.stack([np.ones(np.size(x_um)), np.ravel(x_um), np.ravel(y_um)], axis=1)
